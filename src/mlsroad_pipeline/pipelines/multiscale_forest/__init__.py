"""Random forest on multiscale spherical neighbourhoods (Thomas et al. 2018)."""

from mlsroad_pipeline.pipelines.multiscale_forest.pipeline import create_pipeline

__all__ = ["create_pipeline"]
