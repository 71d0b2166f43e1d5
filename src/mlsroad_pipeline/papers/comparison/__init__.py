"""Comparisons of all methods: on simulated streets, and on recordings of several scanners."""
