"""Benchmark of labellers on recordings as a study."""

from __future__ import annotations

from typing import Any

import pandas as pd

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.papers.comparison.recordings import report
from mlsroad_pipeline.papers.comparison.recordings.plan import (
    StudyPlan,
    parameter_groups,
    plan_study,
    prepare_scenes,
    read_scenes,
    train_models,
)
from mlsroad_pipeline.papers.comparison.recordings.results import study_tables
from mlsroad_pipeline.papers.shared.studies.study import Stage, Study
from mlsroad_pipeline.surveys.recordings import read_scene


def read_recordings(plan: StudyPlan) -> dict[str, SceneTask]:
    """Create one task per file of a recording that reads it, and one per street that simulates it."""
    return read_scenes(plan, read_scene)


def tabulate(plan: StudyPlan, runs: SceneCollection, models: SceneCollection) -> dict[str, pd.DataFrame]:
    """Make the tables of all stored runs."""
    return study_tables(plan, runs.load_all(), models.load_all("times"))


def summarise(plan: StudyPlan, benchmark: pd.DataFrame) -> tuple[dict[str, Any], str]:
    """Return the benchmark as JSON values and as text tables."""
    return report.summary(plan, benchmark), report.markdown_tables(plan, benchmark)


STUDY = Study(
    "recordings",
    "Labellers on recordings",
    parameters=("classes", *parameter_groups()),
    plan=plan_study,
    stages=[
        Stage("read_recordings", read_recordings, [], "scenes"),
        Stage("prepare_recordings", prepare_scenes, ["scenes"], "prepared"),
        Stage("train_on_recordings", train_models, ["prepared"], "models"),
    ],
    results=["runs", "models"],
    tables=("scores", "benchmark", "reliability"),
    tabulate=tabulate,
    captions=report.CAPTIONS,
    draw=report.study_figures,
    facts=report.study_facts,
    page=report.study_page,
)
