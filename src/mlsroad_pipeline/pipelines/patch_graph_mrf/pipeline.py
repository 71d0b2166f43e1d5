"""Wiring of label transfer with refinement."""

from functools import partial

from mlsroad_pipeline.algorithms.patch_graph.refined_classifier import RefinedPatchGraphClassifier
from mlsroad_pipeline.pipelines.patch_graph_mrf.nodes import fit_refinement
from mlsroad_pipeline.pipelines.patch_method import patch_pipeline

create_pipeline = partial(
    patch_pipeline,
    "patch_graph_mrf",
    fit_refinement,
    RefinedPatchGraphClassifier,
    more_inputs=("patch_graph.model", "params:patch_graph"),
)
"""Returns the pipeline: patches and the match graph to a model, and to labels of the scenes it was not trained on."""
