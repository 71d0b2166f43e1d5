"""Objects found by bottom-up and top-down descriptors (Patterson et al. 2008)."""

from mlsroad_pipeline.pipelines.bottom_up_top_down.pipeline import create_pipeline

__all__ = ["create_pipeline"]
