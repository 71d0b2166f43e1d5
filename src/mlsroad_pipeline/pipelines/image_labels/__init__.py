"""Labels of points through camera images (Tomic et al. 2019, section 2.2)."""

from mlsroad_pipeline.pipelines.image_labels.pipeline import create_pipeline

__all__ = ["create_pipeline"]
