"""Baseline of Luo et al. 2019: SHOT descriptors with an SVM."""
