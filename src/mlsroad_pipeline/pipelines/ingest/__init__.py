"""Pipeline that reads a survey and cuts it into scenes."""

from mlsroad_pipeline.pipelines.ingest.pipeline import create_pipeline

__all__ = ["create_pipeline"]
