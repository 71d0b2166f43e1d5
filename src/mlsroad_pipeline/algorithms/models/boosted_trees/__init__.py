"""Gradient-boosted trees on multi-scale voxel features."""
