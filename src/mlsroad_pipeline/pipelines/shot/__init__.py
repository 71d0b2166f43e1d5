"""Objects recognised by `shot`."""

from functools import partial

from mlsroad_pipeline.pipelines.recognition.pipeline import recogniser_pipeline

create_pipeline = partial(recogniser_pipeline, "shot")

__all__ = ["create_pipeline"]
