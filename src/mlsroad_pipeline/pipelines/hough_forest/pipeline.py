"""Wiring of the Hough forest."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.baselines.hough_forest import HoughForestParameters
from mlsroad_pipeline.algorithms.baselines.hough_forest_training import train_hough_forest
from mlsroad_pipeline.algorithms.baselines.object_parts import describe_parts
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
        ``scenes``, ``objects`` and ``object_classes`` to ``hough_forest.model`` and ``hough_forest.detections``.
    """
    return create_detector_pipeline(
        "hough_forest",
        parameters=HoughForestParameters,
        describe=describe_parts,
        described_by="regions",
        train=train_hough_forest,
    )
