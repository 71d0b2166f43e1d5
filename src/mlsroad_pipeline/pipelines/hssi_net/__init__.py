"""Objects recognised by `hssi_net`."""

from functools import partial

from mlsroad_pipeline.pipelines.recognition.pipeline import recogniser_pipeline

create_pipeline = partial(recogniser_pipeline, "hssi_net")

__all__ = ["create_pipeline"]
