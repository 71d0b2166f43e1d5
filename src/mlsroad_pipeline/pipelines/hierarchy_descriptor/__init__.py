"""Objects recognised by `hierarchy_descriptor`."""

from functools import partial

from mlsroad_pipeline.pipelines.recognition.pipeline import recogniser_pipeline

create_pipeline = partial(recogniser_pipeline, "hierarchy_descriptor")

__all__ = ["create_pipeline"]
