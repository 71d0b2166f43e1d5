"""Recognition of objects from files, fold by fold."""

from mlsroad_pipeline.pipelines.object_recognition.pipeline import create_pipeline

__all__ = ["create_pipeline"]
