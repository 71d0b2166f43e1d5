"""Pipeline that reports the quality of a survey."""

from mlsroad_pipeline.pipelines.inspect.pipeline import create_pipeline

__all__ = ["create_pipeline"]
