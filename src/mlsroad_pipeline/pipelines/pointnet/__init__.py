"""Objects recognised by `pointnet`."""

from functools import partial

from mlsroad_pipeline.pipelines.recognition.pipeline import recogniser_pipeline

create_pipeline = partial(recogniser_pipeline, "pointnet")

__all__ = ["create_pipeline"]
