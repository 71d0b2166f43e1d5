"""Wiring of the inspection."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.inspect.nodes import look_through, report_survey


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: a survey's files to a report on their quality, and to warnings.

    Parameters
    ----------
    **_ : object
        Not used; Kedro lets callers of any pipeline give keyword arguments.

    Returns
    -------
    Pipeline
        ``inspect.survey`` to ``inspection``, ``inspection_report`` and ``survey_warnings``.
    """
    found = ["inspected_files", "survey_warnings", "inspected_root"]
    return Pipeline(
        [
            Node(look_through, inputs=["params:inspect", "params:survey"], outputs=found, name="look_through"),
            Node(
                report_survey,
                inputs=["inspected_files", "survey_warnings", "inspected_root"],
                outputs=["inspection", "inspection_report"],
                name="report_survey",
            ),
        ]
    )
