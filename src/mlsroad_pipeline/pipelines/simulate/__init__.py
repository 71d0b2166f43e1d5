"""Simulated surveys by ray casting, in the files of a recording."""

from mlsroad_pipeline.pipelines.simulate.pipeline import create_pipeline

__all__ = ["create_pipeline"]
