"""Benchmark of labellers on recordings of several scanners."""
