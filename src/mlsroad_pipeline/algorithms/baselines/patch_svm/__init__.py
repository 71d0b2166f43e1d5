"""Baseline of Luo et al. 2016: patches labelled by an RBF support vector machine."""
