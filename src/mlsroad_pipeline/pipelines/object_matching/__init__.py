"""Objects found by object matching (Yu et al. 2015)."""

from mlsroad_pipeline.pipelines.object_matching.pipeline import create_pipeline

__all__ = ["create_pipeline"]
