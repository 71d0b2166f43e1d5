"""Wiring of the machine on patches."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.patch_svm.nodes import label_scenes_by_patch_svm, train_patch_svm


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
    return Pipeline(
        [
            Node(
                train_patch_svm,
                inputs=[
                    "patches",
                    "patch_labels",
                    "params:patch_svm",
                    "params:ground_removal",
                    "params:patches",
                    "params:survey",
                    "params:classes",
                ],
                outputs=["patch_svm.model", "patch_svm.registered_model"],
                name="train_patch_svm",
            ),
            Node(
                label_scenes_by_patch_svm,
                inputs=["scenes", "patches", "patch_svm.model"],
                outputs="patch_svm.labels",
                name="label_scenes_by_patch_svm",
            ),
        ]
    )
