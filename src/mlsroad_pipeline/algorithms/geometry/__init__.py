"""Geometric primitives: cell grids, neighbours, graphs, polylines, voxels."""
