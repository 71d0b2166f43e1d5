"""Objects recognised by `jointnet_printed`."""

from functools import partial

from mlsroad_pipeline.pipelines.recognition.pipeline import recogniser_pipeline

create_pipeline = partial(recogniser_pipeline, "jointnet_printed")

__all__ = ["create_pipeline"]
