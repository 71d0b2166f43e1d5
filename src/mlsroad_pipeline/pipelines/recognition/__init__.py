"""Objects that are recognised: cut from scenes or read from files, and how well each method does."""

from mlsroad_pipeline.pipelines.recognition.pipeline import create_pipeline

__all__ = ["create_pipeline"]
