"""Points sorted once into voxels: the ground that the supervoxels and the ground filter stand on."""

from mlsroad_pipeline.algorithms.geometry.voxels.grid import VoxelGrid, build_voxel_grid

__all__ = ["VoxelGrid", "build_voxel_grid"]
