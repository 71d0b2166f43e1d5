"""Segmentation of off-ground points into objects."""

from mlsroad_pipeline.pipelines.segmentation.pipeline import create_pipeline

__all__ = ["create_pipeline"]
