"""Voxel grid of a point cloud."""

from mlsroad_pipeline.algorithms.geometry.voxels.grid import VoxelGrid, build_voxel_grid

__all__ = ["VoxelGrid", "build_voxel_grid"]
