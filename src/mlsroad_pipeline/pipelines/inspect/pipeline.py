"""Wiring of the inspection."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.inspect.nodes import inspect_files


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: a survey's files to a report on their quality, and to warnings."""
    return Pipeline(
        [
            Node(
                inspect_files,
                inputs=["params:inspect", "params:survey"],
                outputs=["inspection", "inspection_report", "survey_warnings"],
                name="inspect_files",
            )
        ]
    )
