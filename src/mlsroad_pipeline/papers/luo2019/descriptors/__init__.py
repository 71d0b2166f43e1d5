"""Baselines of Luo et al. 2019: descriptors with a support vector machine."""
