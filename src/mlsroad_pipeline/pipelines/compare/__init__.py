"""Tables of the scores of all methods."""

from mlsroad_pipeline.pipelines.compare.pipeline import create_pipeline

__all__ = ["create_pipeline"]
