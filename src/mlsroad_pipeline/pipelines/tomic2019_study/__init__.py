"""Experiments of Tomic et al. 2019 on simulated surveys with images."""

from mlsroad_pipeline.pipelines.tomic2019_study.pipeline import create_pipeline

__all__ = ["create_pipeline"]
