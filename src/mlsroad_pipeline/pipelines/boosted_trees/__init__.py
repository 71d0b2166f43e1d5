"""Gradient-boosted trees on multi-scale voxel features."""

from mlsroad_pipeline.pipelines.boosted_trees.pipeline import create_pipeline

__all__ = ["create_pipeline"]
