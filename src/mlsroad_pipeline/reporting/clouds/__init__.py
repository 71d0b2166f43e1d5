"""Rendering of point clouds by splatting."""
