"""Ground points and heights above the ground, scored on labelled surveys."""

from mlsroad_pipeline.pipelines.ground_removal.pipeline import create_pipeline

__all__ = ["create_pipeline"]
