"""Wiring of label transfer."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.patch_graph.classifier import PatchGraphClassifier
from mlsroad_pipeline.pipelines.patch_graph.nodes import train_patch_graph
from mlsroad_pipeline.pipelines.patch_method import patch_pipeline


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: patches to a match graph, and to labels of the scenes that it was not built of.

    Parameters
    ----------
    **_ : object
        Not used; Kedro lets callers of any pipeline give keyword arguments.

    Returns
    -------
    Pipeline
        ``scenes``, ``patches`` and ``patch_labels`` to ``patch_graph.model`` and ``patch_graph.labels``.
    """
    return patch_pipeline(
        "patch_graph",
        train_patch_graph,
        PatchGraphClassifier,
        more_outputs=("patch_graph.objective", "patch_graph.objective_figure"),
    )
