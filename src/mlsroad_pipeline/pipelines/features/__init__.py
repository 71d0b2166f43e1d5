"""Supervoxel features, with and without detrending."""

from mlsroad_pipeline.pipelines.features.pipeline import create_pipeline

__all__ = ["create_pipeline"]
