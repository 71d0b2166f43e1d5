"""All labellers, detectors and recognisers on one survey."""

from mlsroad_pipeline.pipelines.all_methods.pipeline import create_pipeline

__all__ = ["create_pipeline"]
