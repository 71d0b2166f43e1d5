"""Experiments of Luo et al. 2019 on simulated sets of objects."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.papers.luo2019.study.study import STUDY
from mlsroad_pipeline.pipelines import simulated_objects
from mlsroad_pipeline.pipelines.study import study_pipeline


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline of the study and of its simulated sets."""
    return simulated_objects.create_pipeline() + study_pipeline(STUDY)
