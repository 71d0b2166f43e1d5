"""Report of a comparison on one page."""

from mlsroad_pipeline.pipelines.report.pipeline import create_pipeline

__all__ = ["create_pipeline"]
