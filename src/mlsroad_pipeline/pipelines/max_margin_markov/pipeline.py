"""Wiring of the max-margin Markov network."""

from functools import partial

from mlsroad_pipeline.algorithms.baselines.max_margin_markov.classifier import MaxMarginMarkov
from mlsroad_pipeline.algorithms.baselines.max_margin_markov.training import MarginParameters, train
from mlsroad_pipeline.pipelines.patch_method import patch_pipeline, training_node

create_pipeline = partial(patch_pipeline, "max_margin_markov", training_node(train, MarginParameters), MaxMarginMarkov)
"""Returns the pipeline: patches to a model, and to labels of the scenes that it was not trained on."""
