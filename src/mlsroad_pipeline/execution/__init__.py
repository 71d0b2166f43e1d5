"""Execution of scene tasks: stores, workers, fingerprints."""
