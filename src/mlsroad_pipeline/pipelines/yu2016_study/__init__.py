"""Experiments of Yu et al. 2016 on simulated streets."""

from mlsroad_pipeline.pipelines.yu2016_study.pipeline import create_pipeline

__all__ = ["create_pipeline"]
