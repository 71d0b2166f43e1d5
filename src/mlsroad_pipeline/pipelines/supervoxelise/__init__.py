"""Supervoxels of scenes, and the quality of the partition."""

from mlsroad_pipeline.pipelines.supervoxelise.pipeline import create_pipeline

__all__ = ["create_pipeline"]
