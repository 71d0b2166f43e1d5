"""Experiments of Tomic et al. 2019 on simulated surveys with images."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.papers.tomic2019.study.study import STUDY
from mlsroad_pipeline.pipelines.study import study_pipeline


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline of the study."""
    return study_pipeline(STUDY)
