"""Objects that come in files of their own, recognised fold by fold."""

from mlsroad_pipeline.pipelines.object_recognition.pipeline import create_pipeline

__all__ = ["create_pipeline"]
