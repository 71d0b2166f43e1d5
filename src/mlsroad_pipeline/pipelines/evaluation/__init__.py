"""Every labeller scored at full resolution by the same code."""

from mlsroad_pipeline.pipelines.evaluation.pipeline import create_pipeline

__all__ = ["create_pipeline"]
