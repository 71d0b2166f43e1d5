"""Baseline of Luo et al. 2016: patches labelled by a random forest."""
