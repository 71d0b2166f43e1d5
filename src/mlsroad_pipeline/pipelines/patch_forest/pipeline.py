"""Wiring of the forest on patches."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.patch_forest.nodes import label_scenes_by_patch_forest, train_patch_forest


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: patches to a model, and to labels of the scenes that it was not trained on.

    Parameters
    ----------
    **_ : object
        Not used; Kedro lets callers of any pipeline give keyword arguments.

    Returns
    -------
    Pipeline
        ``scenes``, ``patches`` and ``patch_labels`` to ``patch_forest.model`` and ``patch_forest.labels``.
    """
    return Pipeline(
        [
            Node(
                train_patch_forest,
                inputs=[
                    "patches",
                    "patch_labels",
                    "params:patch_forest",
                    "params:ground_removal",
                    "params:patches",
                    "params:survey",
                    "params:classes",
                ],
                outputs=["patch_forest.model", "patch_forest.registered_model"],
                name="train_patch_forest",
            ),
            Node(
                label_scenes_by_patch_forest,
                inputs=["scenes", "patches", "patch_forest.model"],
                outputs="patch_forest.labels",
                name="label_scenes_by_patch_forest",
            ),
        ]
    )
