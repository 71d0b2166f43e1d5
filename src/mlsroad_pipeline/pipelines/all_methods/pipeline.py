"""Wiring of all methods: the default comparison, the recognisers, and the labels through images."""

from importlib import import_module

from kedro.pipeline import Pipeline

from mlsroad_pipeline.pipelines.methods import COMPARISON, IMAGE_LABELLER, joined


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: a survey with images to the scores of every method.

    Fusion is not among them: it learns on half of the test streets, and is scored on the other half.

    Parameters
    ----------
    **_ : object
        Not used; Kedro lets callers of any pipeline give keyword arguments.

    Returns
    -------
    Pipeline
        The default comparison, `recognition` and `image_labels`.
    """
    names = (*COMPARISON, "recognition", IMAGE_LABELLER)
    return joined({name: import_module(f"mlsroad_pipeline.pipelines.{name}").create_pipeline() for name in names})
