"""Nodes of the benchmark of recordings; the other stages are in `studies.recordings.plan`."""

from __future__ import annotations

from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.model_store.shipped_models import load_shipped
from mlsroad_pipeline.papers.comparison.recordings.plan import StudyPlan, read_scenes, score_runs
from mlsroad_pipeline.papers.comparison.recordings.report import markdown_tables, study_figures, summary
from mlsroad_pipeline.papers.comparison.recordings.results import StudyTables, study_tables
from mlsroad_pipeline.surveys.recordings import read_scene


def read_recordings(plan: StudyPlan) -> dict[str, SceneTask]:
    """Create one task per file of a recording that reads it, and one per street that simulates it."""
    return read_scenes(plan, read_scene)


def score_recordings(plan: StudyPlan, scenes: SceneCollection, models: SceneCollection) -> dict[str, SceneTask]:
    """Create one task per run that labels a recording and scores the labels."""
    return score_runs(plan, scenes, models, {name: load_shipped(name) for name in plan.study.models})


def tabulate_study(plan: StudyPlan, runs: SceneCollection, models: SceneCollection) -> StudyTables:
    """Make the tables of all stored runs."""
    return study_tables(plan, runs.load_all(), models.load_all("times"))


def draw_study(tables: StudyTables) -> tuple[Figure, ...]:
    """Draw the figures of the report."""
    return study_figures(tables)


def summarise(plan: StudyPlan, benchmark: pd.DataFrame) -> tuple[dict[str, Any], str]:
    """Return the benchmark as JSON values and as text tables."""
    return summary(plan, benchmark), markdown_tables(plan, benchmark)
