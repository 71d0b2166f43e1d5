"""Benchmark of labellers on recordings of several scanners."""

from dataclasses import replace

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.model_store.shipped_models import load_shipped
from mlsroad_pipeline.papers.comparison.recordings.plan import StudyPlan, score_runs
from mlsroad_pipeline.papers.comparison.recordings.report import STUDY, source_pages, summarise
from mlsroad_pipeline.papers.shared.studies.study import Stage
from mlsroad_pipeline.pipelines.study import study_pipeline


def score_recordings(plan: StudyPlan, scenes: SceneCollection, models: SceneCollection) -> dict[str, SceneTask]:
    """Create one task per run that labels a recording and scores the labels; the plan names models of the package."""
    return score_runs(plan, scenes, models, {name: load_shipped(name) for name in plan.study.models})


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline of the study, and of its summary, text tables and pictures."""
    plan, scenes, runs, benchmark, pictures, *texts = (
        f"recordings_study.{name}"
        for name in ("plan", "scenes", "runs", "benchmark", "pictures", "summary", "markdown")
    )
    scoring = Stage("score_recordings", score_recordings, ["scenes", "models"], "runs")
    return study_pipeline(replace(STUDY, stages=[*STUDY.stages, scoring])) + Pipeline(
        [
            Node(summarise, [plan, benchmark], texts, name="summarise_recordings"),
            Node(source_pages, [plan, scenes, runs], pictures, name="draw_recordings"),
        ]
    )
