"""Shape-based recognition of objects (Golovinskiy et al. 2009, a baseline of Luo et al. 2016)."""

from mlsroad_pipeline.pipelines.shape_based.pipeline import create_pipeline

__all__ = ["create_pipeline"]
