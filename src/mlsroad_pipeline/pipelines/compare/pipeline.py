"""Wiring of the comparison."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.compare.nodes import compare_methods
from mlsroad_pipeline.pipelines.methods import LABELLERS


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scores of every method to one table.

    Parameters
    ----------
    **_ : object
        Not used; Kedro lets callers of any pipeline give keyword arguments.

    Returns
    -------
    Pipeline
        ``<slug>.scores`` of every labeller to ``comparison``.
    """
    scores = [f"{slug}.scores" for slug in LABELLERS]
    return Pipeline([Node(compare_methods, inputs=scores, outputs="comparison", name="compare_methods")])
