"""Wiring of the object matching."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.baselines.object_matching import ObjectMatchingParameters
from mlsroad_pipeline.algorithms.baselines.object_matching_training import train_object_matching
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
        ``scenes``, ``objects`` and ``object_classes`` to ``object_matching.model`` and ``object_matching.detections``.
    """
    return create_detector_pipeline(
        "object_matching",
        parameters=ObjectMatchingParameters,
        describe=describe_parts,
        described_by="regions",
        train=train_object_matching,
    )
