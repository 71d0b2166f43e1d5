"""Objects found by bags of contextual visual words (Yu et al. 2016)."""

from mlsroad_pipeline.pipelines.visual_words.pipeline import create_pipeline

__all__ = ["create_pipeline"]
