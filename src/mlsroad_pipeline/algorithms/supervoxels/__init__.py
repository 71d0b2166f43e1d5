"""Supervoxels: compact, connected segments of a cloud that preserve object boundaries."""
