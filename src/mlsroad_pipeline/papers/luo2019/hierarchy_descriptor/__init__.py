"""Baseline of Luo et al. 2019: vertical profiles with an SVM."""
