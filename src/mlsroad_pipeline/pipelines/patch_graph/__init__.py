"""Label transfer with the 3-D patch match graph (Luo et al. 2016, sections III-B and III-C)."""

from mlsroad_pipeline.pipelines.patch_graph.pipeline import create_pipeline

__all__ = ["create_pipeline"]
