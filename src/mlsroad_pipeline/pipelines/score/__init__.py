"""Pipeline that scores an inventory against a table of true objects."""

from mlsroad_pipeline.pipelines.score.pipeline import create_pipeline

__all__ = ["create_pipeline"]
