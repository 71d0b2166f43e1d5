"""All methods compared over several test streets, on one page."""

from mlsroad_pipeline.pipelines.comparison_report.pipeline import create_pipeline

__all__ = ["create_pipeline"]
