"""Simulated surveys, ray-cast and written as a real one is delivered."""

from mlsroad_pipeline.pipelines.simulate.pipeline import create_pipeline

__all__ = ["create_pipeline"]
