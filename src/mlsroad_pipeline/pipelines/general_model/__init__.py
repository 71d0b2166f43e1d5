"""Pipeline that trains the default model of the package on simulated streets and recordings."""

from mlsroad_pipeline.pipelines.general_model.pipeline import create_pipeline

__all__ = ["create_pipeline"]
