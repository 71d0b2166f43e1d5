"""Patches of scenes, and the classes of the training patches (Luo et al. 2016, section III-A)."""

from mlsroad_pipeline.pipelines.patches.pipeline import create_pipeline

__all__ = ["create_pipeline"]
