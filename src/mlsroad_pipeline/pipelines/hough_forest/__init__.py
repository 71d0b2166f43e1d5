"""Objects found by Hough forest (Wang et al. 2015)."""

from mlsroad_pipeline.pipelines.hough_forest.pipeline import create_pipeline

__all__ = ["create_pipeline"]
