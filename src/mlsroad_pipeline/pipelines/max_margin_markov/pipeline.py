"""Wiring of the max-margin Markov network."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.baselines.max_margin_markov import MaxMarginMarkov
from mlsroad_pipeline.algorithms.baselines.max_margin_training import MarginParameters, train
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
        ``scenes``, ``patches`` and ``patch_labels`` to ``max_margin_markov.model`` and ``max_margin_markov.labels``.
    """
    return patch_pipeline("max_margin_markov", training_node(train, MarginParameters), MaxMarginMarkov)
