"""Benchmark of labellers on recordings of several scanners."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.papers.comparison.recordings.report import source_pages
from mlsroad_pipeline.papers.comparison.recordings.study import STUDY, summarise
from mlsroad_pipeline.pipelines.study import study_pipeline


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline of the study, and of its summary, text tables and pictures."""
    plan, scenes, runs, benchmark, pictures, *texts = (
        f"recordings_study.{name}"
        for name in ("plan", "scenes", "runs", "benchmark", "pictures", "summary", "markdown")
    )
    return study_pipeline(STUDY) + Pipeline(
        [
            Node(summarise, [plan, benchmark], texts, name="summarise_recordings"),
            Node(source_pages, [plan, scenes, runs], pictures, name="draw_recordings"),
        ]
    )
