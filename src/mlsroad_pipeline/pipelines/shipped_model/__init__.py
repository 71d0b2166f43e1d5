"""Pipeline that trains a model for the package."""

from mlsroad_pipeline.pipelines.shipped_model.pipeline import create_pipeline

__all__ = ["create_pipeline"]
