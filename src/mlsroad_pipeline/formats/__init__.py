"""Readers and writers of point cloud formats, selected through a registry."""
