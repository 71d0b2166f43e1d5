"""Support vector machine on patches (a rival of Luo et al. 2016)."""

from mlsroad_pipeline.pipelines.patch_svm.pipeline import create_pipeline

__all__ = ["create_pipeline"]
