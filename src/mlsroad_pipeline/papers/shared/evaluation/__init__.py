"""Evaluation of labels and shared stages against a reference."""
