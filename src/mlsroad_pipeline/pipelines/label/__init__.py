"""Pipeline that labels a survey, with an inventory of objects and a report."""

from mlsroad_pipeline.pipelines.label.pipeline import create_pipeline

__all__ = ["create_pipeline"]
