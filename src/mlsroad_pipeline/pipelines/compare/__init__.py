"""The scores of all methods side by side."""

from mlsroad_pipeline.pipelines.compare.pipeline import create_pipeline

__all__ = ["create_pipeline"]
