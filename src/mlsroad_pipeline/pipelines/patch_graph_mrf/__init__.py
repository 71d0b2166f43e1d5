"""Transferred labels refined by a Markov random field (Luo et al. 2016, section III-D)."""

from mlsroad_pipeline.pipelines.patch_graph_mrf.pipeline import create_pipeline

__all__ = ["create_pipeline"]
