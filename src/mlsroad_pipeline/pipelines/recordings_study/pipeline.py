"""Pipeline of the benchmark of recordings."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.papers.comparison.recordings.pictures import source_pages
from mlsroad_pipeline.papers.comparison.recordings.plan import (
    parameter_groups,
    plan_study,
    prepare_scenes,
    train_models,
)
from mlsroad_pipeline.papers.comparison.recordings.report import CAPTIONS, study_sections
from mlsroad_pipeline.papers.comparison.recordings.results import StudyTables
from mlsroad_pipeline.pipelines.recordings_study.nodes import (
    draw_study,
    read_recordings,
    score_recordings,
    summarise,
    tabulate_study,
)
from mlsroad_pipeline.pipelines.study import Stage, StudyReport, study_pipeline


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: recordings and streets to models, scores, tables, a report and pictures."""
    study = study_pipeline(
        "recordings",
        parameters=("classes", *parameter_groups()),
        plan=plan_study,
        stages=[
            Stage("read_recordings", read_recordings, [], "scenes"),
            Stage("prepare_recordings", prepare_scenes, ["scenes"], "prepared"),
            Stage("train_on_recordings", train_models, ["prepared"], "models"),
            Stage("score_recordings", score_recordings, ["scenes", "models"], "runs"),
        ],
        report=StudyReport(
            "Labellers on recordings",
            tables=StudyTables,
            tabulate=tabulate_study,
            results=["runs", "models"],
            captions=CAPTIONS,
            draw=draw_study,
            write=study_sections,
        ),
    )
    entries = {name: f"recordings_study.{name}" for name in ("plan", "scenes", "runs", "benchmark", "pictures")}
    texts = ["recordings_study.summary", "recordings_study.markdown"]
    return study + Pipeline(
        [
            Node(summarise, [entries["plan"], entries["benchmark"]], texts, name="summarise_recordings"),
            Node(
                source_pages, [entries["plan"], entries["scenes"], entries["runs"]], entries["pictures"],
                name="draw_recordings",
            ),
        ]
    )  # fmt: skip
