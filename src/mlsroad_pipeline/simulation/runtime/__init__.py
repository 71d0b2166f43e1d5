"""Simulation of whole surveys: streaming, worker pool, merge by time."""
