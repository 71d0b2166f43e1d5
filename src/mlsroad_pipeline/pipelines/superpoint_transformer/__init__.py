"""Superpoint transformer (Robert et al. 2023)."""

from mlsroad_pipeline.pipelines.superpoint_transformer.pipeline import create_pipeline

__all__ = ["create_pipeline"]
