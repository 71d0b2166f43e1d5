"""Ground points and heights above the ground, scored where there are labels."""

from mlsroad_pipeline.pipelines.ground_removal.pipeline import create_pipeline

__all__ = ["create_pipeline"]
