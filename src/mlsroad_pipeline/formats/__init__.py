"""Readers and writers of point cloud formats, found through a registry."""
