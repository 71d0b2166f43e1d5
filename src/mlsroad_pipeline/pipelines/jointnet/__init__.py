"""Objects recognised by `jointnet`."""

from functools import partial

from mlsroad_pipeline.pipelines.recognition.pipeline import recogniser_pipeline

create_pipeline = partial(recogniser_pipeline, "jointnet")

__all__ = ["create_pipeline"]
