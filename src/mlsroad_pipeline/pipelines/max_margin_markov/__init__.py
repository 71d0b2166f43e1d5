"""Max-margin Markov network on patches (Munoz et al. 2009, a rival of Luo et al. 2016)."""

from mlsroad_pipeline.pipelines.max_margin_markov.pipeline import create_pipeline

__all__ = ["create_pipeline"]
