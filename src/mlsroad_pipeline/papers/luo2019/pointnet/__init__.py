"""Baseline of Luo et al. 2019: PointNet."""
