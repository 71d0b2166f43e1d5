"""Experiments of Luo et al. 2016 on simulated streets."""

from mlsroad_pipeline.pipelines.luo2016_study.pipeline import create_pipeline

__all__ = ["create_pipeline"]
