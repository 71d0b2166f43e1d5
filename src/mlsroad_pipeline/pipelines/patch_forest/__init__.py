"""Random forest on patches (a rival of Luo et al. 2016)."""

from mlsroad_pipeline.pipelines.patch_forest.pipeline import create_pipeline

__all__ = ["create_pipeline"]
