"""Wiring of the inspection."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.ingest.pipeline import create_pipeline as create_ingest
from mlsroad_pipeline.pipelines.inspect.nodes import warn_of_quality


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: a survey's files to their quality and to warnings.

    Parameters
    ----------
    **_ : object
        Not used; Kedro lets callers of any pipeline give keyword arguments.

    Returns
    -------
    Pipeline
        ``simulate`` and ``ingest``, and ``survey_warnings``.
    """
    warn = Node(warn_of_quality, inputs=["survey_plan", "pieces"], outputs="survey_warnings", name="warn_of_quality")
    return create_ingest() + Pipeline([warn])
