"""Wiring of label transfer."""

from functools import partial

from mlsroad_pipeline.algorithms.patch_graph.classifier import PatchGraphClassifier
from mlsroad_pipeline.pipelines.patch_graph.nodes import train_patch_graph
from mlsroad_pipeline.pipelines.patch_method import patch_pipeline

create_pipeline = partial(
    patch_pipeline,
    "patch_graph",
    train_patch_graph,
    PatchGraphClassifier,
    more_outputs=("patch_graph.objective", "patch_graph.objective_figure"),
)
"""Returns the pipeline: patches to a match graph, and to labels of the scenes that it was not built of."""
