"""The quality of a survey, before anything is done with it."""

from mlsroad_pipeline.pipelines.inspect.pipeline import create_pipeline

__all__ = ["create_pipeline"]
