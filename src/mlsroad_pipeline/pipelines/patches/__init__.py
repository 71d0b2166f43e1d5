"""Scenes cut into patches, and the classes of those that methods learn from (Luo et al. 2016, section III-A)."""

from mlsroad_pipeline.pipelines.patches.pipeline import create_pipeline

__all__ = ["create_pipeline"]
