"""Wiring of the machine on patches."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.baselines.patch_svm import PatchSvm, PatchSvmParameters
from mlsroad_pipeline.algorithms.baselines.patch_svm_training import train
from mlsroad_pipeline.pipelines.patch_method import patch_pipeline, training_node


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
    return patch_pipeline("patch_svm", training_node(train, PatchSvmParameters), PatchSvm)
