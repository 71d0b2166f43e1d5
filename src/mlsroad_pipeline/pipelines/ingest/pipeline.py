"""Wiring of the ingest."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.ingest.nodes import (
    assemble_scenes,
    cut_files,
    describe_files,
    find_corridors,
    plan_files,
    report_quality,
)


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: a survey to scenes and its quality report."""
    return (
        Pipeline(
            [
                Node(
                    plan_files,
                    inputs=["params:survey", "params:ingest", "params:classes", "simulated_surveys"],
                    outputs="survey_plan",
                    name="plan_files",
                ),
                Node(
                    describe_files,
                    inputs=["survey_plan", "params:ingest"],
                    outputs="survey_files",
                    name="describe_files",
                ),
                Node(
                    find_corridors,
                    inputs=["survey_plan", "survey_files", "params:ingest"],
                    outputs="corridors",
                    name="find_corridors",
                ),
                Node(
                    cut_files,
                    inputs=["survey_plan", "survey_files", "corridors", "params:ingest"],
                    outputs="pieces",
                    name="cut_files",
                ),
                Node(
                    assemble_scenes,
                    inputs=["survey_plan", "pieces", "params:ingest"],
                    outputs="scenes",
                    name="assemble_scenes",
                ),
                Node(report_quality, inputs=["survey_plan", "pieces"], outputs="survey_quality", name="report_quality"),
            ]
        )
        + _simulated()
    )


def _simulated() -> Pipeline:
    """Return what simulates the survey where the environment says so."""
    # `label` takes its nodes from this package and must not load the simulator with them
    from mlsroad_pipeline.pipelines.simulate.pipeline import create_pipeline as create_simulate  # noqa: PLC0415

    return create_simulate()
