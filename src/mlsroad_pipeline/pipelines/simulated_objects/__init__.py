"""Sets of objects from simulated surveys."""

from mlsroad_pipeline.pipelines.simulated_objects.pipeline import create_pipeline

__all__ = ["create_pipeline"]
