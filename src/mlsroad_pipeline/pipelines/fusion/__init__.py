"""Fusion of the labels by features and through images (Tomic et al. 2019, section 2.3)."""

from mlsroad_pipeline.pipelines.fusion.pipeline import create_pipeline

__all__ = ["create_pipeline"]
