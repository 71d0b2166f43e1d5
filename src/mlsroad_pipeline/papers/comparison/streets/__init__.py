"""Comparison of all methods over several surveys."""
