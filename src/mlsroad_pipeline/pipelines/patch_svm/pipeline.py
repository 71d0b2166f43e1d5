"""Wiring of the machine on patches."""

from functools import partial

from mlsroad_pipeline.algorithms.baselines.patch_svm.classifier import PatchSvm, PatchSvmParameters
from mlsroad_pipeline.algorithms.baselines.patch_svm.training import train
from mlsroad_pipeline.pipelines.patch_method import patch_pipeline, training_node

create_pipeline = partial(patch_pipeline, "patch_svm", training_node(train, PatchSvmParameters), PatchSvm)
"""Returns the pipeline: patches to a model, and to labels of the scenes that it was not trained on."""
