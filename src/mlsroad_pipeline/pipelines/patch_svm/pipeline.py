"""Wiring of the machine on patches."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.baselines.patch_svm import PatchSvm
from mlsroad_pipeline.pipelines.patch_method import patch_pipeline
from mlsroad_pipeline.pipelines.patch_svm.nodes import train_patch_svm


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: patches to a model, and to labels of the scenes that it was not trained on.

    Parameters
    ----------
    **_ : object
        Not used; Kedro lets callers of any pipeline give keyword arguments.

    Returns
    -------
    Pipeline
        ``scenes``, ``patches`` and ``patch_labels`` to ``patch_svm.model`` and ``patch_svm.labels``.
    """
    return patch_pipeline("patch_svm", train_patch_svm, PatchSvm)
