"""Wiring of the forest on patches."""

from functools import partial

from mlsroad_pipeline.algorithms.baselines.patch_forest.classifier import PatchForest, PatchForestParameters, train
from mlsroad_pipeline.pipelines.patch_method import patch_pipeline, training_node

create_pipeline = partial(patch_pipeline, "patch_forest", training_node(train, PatchForestParameters), PatchForest)
"""Returns the pipeline: patches to a model, and to labels of the scenes that it was not trained on."""
