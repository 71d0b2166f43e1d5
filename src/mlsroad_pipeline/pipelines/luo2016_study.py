"""Experiments of Luo et al. 2016 on simulated streets."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.papers.luo2016.study.study import STUDY
from mlsroad_pipeline.pipelines.study import study_pipeline


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline of the study."""
    return study_pipeline(STUDY)
