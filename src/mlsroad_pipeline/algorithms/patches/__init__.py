"""Patches of supervoxels and the methods that label them."""
