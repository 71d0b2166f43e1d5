"""Pipeline of the inspection."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.inspect.nodes import inspect_files


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline from the files of a survey to a quality report and warnings."""
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
