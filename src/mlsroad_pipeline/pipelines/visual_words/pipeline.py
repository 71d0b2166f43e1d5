"""Wiring of the visual words."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.visual_words.labeller import describe_objects
from mlsroad_pipeline.algorithms.visual_words.training import VisualWordsParameters, train_detector
from mlsroad_pipeline.pipelines.detector import create_detector_pipeline


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: objects to a model, and to detections in the scenes that it was not trained on.

    Parameters
    ----------
    **_ : object
        Not used; Kedro lets callers of any pipeline give keyword arguments.

    Returns
    -------
    Pipeline
        ``scenes``, ``objects`` and ``object_classes`` to ``visual_words.model`` and ``visual_words.detections``.
    """
    return create_detector_pipeline(
        "visual_words",
        parameters=VisualWordsParameters,
        describe=describe_objects,
        described_by="groups",
        train=train_detector,
        parts="groups",
    )
