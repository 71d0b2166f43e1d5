"""Experiments of Luo et al. 2019 on simulated sets of objects."""

from mlsroad_pipeline.pipelines.luo2019_study.pipeline import create_pipeline

__all__ = ["create_pipeline"]
