"""Objects recognised by `vaai_net`."""

from functools import partial

from mlsroad_pipeline.pipelines.recognition.pipeline import recogniser_pipeline

create_pipeline = partial(recogniser_pipeline, "vaai_net")

__all__ = ["create_pipeline"]
