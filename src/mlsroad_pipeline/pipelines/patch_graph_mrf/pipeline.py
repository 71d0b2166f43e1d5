"""Wiring of label transfer with refinement."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.patch_graph_mrf.nodes import fit_refinement, refine_labels


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
    return Pipeline(
        [
            Node(
                fit_refinement,
                inputs=[
                    "patches",
                    "patch_labels",
                    "patch_graph.model",
                    "params:patch_graph_mrf",
                    "params:patch_graph",
                    "params:ground_removal",
                    "params:patches",
                    "params:survey",
                    "params:classes",
                ],
                outputs=["patch_graph_mrf.model", "patch_graph_mrf.registered_model"],
                name="fit_refinement",
            ),
            Node(
                refine_labels,
                inputs=["scenes", "patches", "patch_graph_mrf.model"],
                outputs="patch_graph_mrf.labels",
                name="refine_labels",
            ),
        ]
    )
