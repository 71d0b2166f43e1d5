"""Benchmark of labellers on recordings of several scanners."""

from mlsroad_pipeline.pipelines.recordings_study.pipeline import create_pipeline

__all__ = ["create_pipeline"]
