"""Octree patches and their classifiers."""
