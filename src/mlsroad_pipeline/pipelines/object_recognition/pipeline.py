"""Wiring of the recognition of objects in files."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.pipelines.methods import RECOGNISERS
from mlsroad_pipeline.pipelines.recognition.pipeline import read_folds, recogniser_pipeline, score_recognisers


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: files of objects to the scores of all recognisers."""
    methods: list[Pipeline] = [recogniser_pipeline(slug) for slug in RECOGNISERS]
    return sum([*methods, score_recognisers()], read_folds())
