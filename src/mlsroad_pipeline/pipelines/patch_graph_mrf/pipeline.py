"""Wiring of label transfer with refinement."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.patch_graph.refined_classifier import RefinedPatchGraphClassifier
from mlsroad_pipeline.pipelines.patch_graph_mrf.nodes import fit_refinement
from mlsroad_pipeline.pipelines.patch_method import patch_pipeline


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: patches and the match graph to a model, and to labels of the scenes it was not trained on.

    Parameters
    ----------
    **_ : object
        Not used; Kedro lets callers of any pipeline give keyword arguments.

    Returns
    -------
    Pipeline
        ``scenes``, ``patches``, ``patch_labels`` and ``patch_graph.model`` to ``patch_graph_mrf.model`` and
        ``patch_graph_mrf.labels``.
    """
    return patch_pipeline(
        "patch_graph_mrf",
        fit_refinement,
        RefinedPatchGraphClassifier,
        more_inputs=("patch_graph.model", "params:patch_graph"),
    )
