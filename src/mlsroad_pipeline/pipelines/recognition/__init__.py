"""Recognition of objects from scenes, and scores of all recognisers."""

from mlsroad_pipeline.pipelines.recognition.pipeline import create_pipeline

__all__ = ["create_pipeline"]
