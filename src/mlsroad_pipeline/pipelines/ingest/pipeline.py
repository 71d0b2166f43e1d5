"""Pipeline of the ingest."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.ingest.nodes import (
    assemble_scenes,
    cut_files,
    describe_files,
    find_corridors,
    plan_files,
    report_quality,
)


def cut_survey() -> Pipeline:
    """Return the pipeline from the plan of a survey to its pieces and its quality; `label` has it in a namespace."""
    return Pipeline(
        [
            Node(
                describe_files, inputs=["survey_plan", "params:ingest"], outputs="survey_files", name="describe_files"
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
            Node(report_quality, inputs=["survey_plan", "pieces"], outputs="survey_quality", name="report_quality"),
        ]
    )


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline from the files of a comparison, simulated ones included, to scenes and a quality report."""
    # Importing `label` imports this module and must not load the simulator.
    from mlsroad_pipeline.pipelines.simulate.pipeline import create_pipeline as simulate  # noqa: PLC0415

    plan = Node(
        plan_files,
        inputs=["params:survey", "params:ingest", "params:classes", "simulated_surveys"],
        outputs="survey_plan",
        name="plan_files",
    )
    assemble = Node(
        assemble_scenes, inputs=["survey_plan", "pieces", "params:ingest"], outputs="scenes", name="assemble_scenes"
    )
    return simulate() + Pipeline([plan, cut_survey(), assemble])
