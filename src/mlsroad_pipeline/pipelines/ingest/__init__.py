"""A survey read, inspected, split and cut into scenes."""

from mlsroad_pipeline.pipelines.ingest.pipeline import create_pipeline

__all__ = ["create_pipeline"]
