"""Random forest on detrended supervoxel features (Tomic et al. 2019, section 2.1)."""

from mlsroad_pipeline.pipelines.detrended_forest.pipeline import create_pipeline

__all__ = ["create_pipeline"]
