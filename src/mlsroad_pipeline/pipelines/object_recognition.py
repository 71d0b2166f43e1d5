"""Recognition of objects from files, fold by fold."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.pipelines.recognition import read_folds, score_recognisers, train_recognisers


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: files of objects to the scores of all recognisers."""
    return read_folds() + train_recognisers() + score_recognisers()
