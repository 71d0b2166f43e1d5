"""Objects recognised by `spin_image`."""

from functools import partial

from mlsroad_pipeline.pipelines.recognition.pipeline import recogniser_pipeline

create_pipeline = partial(recogniser_pipeline, "spin_image")

__all__ = ["create_pipeline"]
