"""Evaluation of all methods by the same code, at full resolution."""

from mlsroad_pipeline.pipelines.evaluation.pipeline import create_pipeline

__all__ = ["create_pipeline"]
