"""Wiring of the bottom-up and top-down descriptors."""

from functools import partial

from mlsroad_pipeline.algorithms.baselines.bottom_up_top_down.detector import BottomUpTopDownParameters
from mlsroad_pipeline.algorithms.baselines.bottom_up_top_down.oriented_points import describe_surfaces
from mlsroad_pipeline.algorithms.baselines.bottom_up_top_down.training import train_bottom_up_top_down
from mlsroad_pipeline.pipelines.detector import detector_pipeline

create_pipeline = partial(
    detector_pipeline,
    "bottom_up_top_down",
    parameters=BottomUpTopDownParameters,
    describe=describe_surfaces,
    described_by="surfaces",
    train=train_bottom_up_top_down,
)
"""Returns the pipeline: objects to a model, and to detections in the scenes that it was not trained on."""
