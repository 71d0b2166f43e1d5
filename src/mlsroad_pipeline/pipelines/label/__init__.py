"""A survey in; a labelled survey, an inventory of objects and a report out."""

from mlsroad_pipeline.pipelines.label.pipeline import create_pipeline

__all__ = ["create_pipeline"]
