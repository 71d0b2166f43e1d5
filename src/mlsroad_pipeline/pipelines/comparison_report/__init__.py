"""Report that compares all methods over several test streets."""

from mlsroad_pipeline.pipelines.comparison_report.pipeline import create_pipeline

__all__ = ["create_pipeline"]
