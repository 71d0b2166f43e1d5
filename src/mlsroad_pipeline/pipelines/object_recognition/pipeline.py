"""Wiring of the recognition of objects in files."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.pipelines.methods import RECOGNISERS
from mlsroad_pipeline.pipelines.recognition.pipeline import read_folds, recogniser_pipeline, score_recognisers


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: files of objects to the scores of all recognisers.

    Parameters
    ----------
    **_ : object
        Not used; Kedro lets callers of any pipeline give keyword arguments.

    Returns
    -------
    Pipeline
        The folds below the survey's root to ``object_sets``, ``<slug>.scores`` and ``recognition_comparison``.
    """
    methods: list[Pipeline] = [recogniser_pipeline(slug) for slug in RECOGNISERS]
    return sum([*methods, score_recognisers()], read_folds())
