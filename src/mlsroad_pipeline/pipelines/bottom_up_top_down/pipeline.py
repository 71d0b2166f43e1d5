"""Wiring of the bottom-up and top-down descriptors."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.baselines.bottom_up_top_down import BottomUpTopDownParameters
from mlsroad_pipeline.algorithms.baselines.bottom_up_top_down_training import train_bottom_up_top_down
from mlsroad_pipeline.algorithms.baselines.oriented_points import describe_surfaces
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
        ``scenes``, ``objects`` and ``object_classes`` to ``bottom_up_top_down.model`` and its ``detections``.
    """
    return create_detector_pipeline(
        "bottom_up_top_down",
        parameters=BottomUpTopDownParameters,
        describe=describe_surfaces,
        described_by="surfaces",
        train=train_bottom_up_top_down,
    )
