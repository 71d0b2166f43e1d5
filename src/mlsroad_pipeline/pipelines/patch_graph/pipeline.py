"""Wiring of label transfer."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.patch_graph.nodes import train_patch_graph, transfer_labels


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
    return Pipeline(
        [
            Node(
                train_patch_graph,
                inputs=[
                    "patches",
                    "patch_labels",
                    "params:patch_graph",
                    "params:ground_removal",
                    "params:patches",
                    "params:survey",
                    "params:classes",
                ],
                outputs=[
                    "patch_graph.model",
                    "patch_graph.registered_model",
                    "patch_graph.objective",
                    "patch_graph.objective_figure",
                ],
                name="train_patch_graph",
            ),
            Node(
                transfer_labels,
                inputs=["scenes", "patches", "patch_graph.model"],
                outputs="patch_graph.labels",
                name="transfer_labels",
            ),
        ]
    )
