"""Wiring of the max-margin Markov network."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.max_margin_markov.nodes import (
    label_scenes_by_max_margin_markov,
    train_max_margin_markov,
)


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
    return Pipeline(
        [
            Node(
                train_max_margin_markov,
                inputs=[
                    "patches",
                    "patch_labels",
                    "params:max_margin_markov",
                    "params:ground_removal",
                    "params:patches",
                    "params:survey",
                    "params:classes",
                ],
                outputs=["max_margin_markov.model", "max_margin_markov.registered_model"],
                name="train_max_margin_markov",
            ),
            Node(
                label_scenes_by_max_margin_markov,
                inputs=["scenes", "patches", "max_margin_markov.model"],
                outputs="max_margin_markov.labels",
                name="label_scenes_by_max_margin_markov",
            ),
        ]
    )
