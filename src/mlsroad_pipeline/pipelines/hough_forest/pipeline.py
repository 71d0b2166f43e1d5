"""Wiring of the Hough forest."""

from functools import partial

from mlsroad_pipeline.algorithms.baselines.hough_forest.detector import HoughForestParameters
from mlsroad_pipeline.algorithms.baselines.hough_forest.training import train_hough_forest
from mlsroad_pipeline.algorithms.detection.parts import describe_parts
from mlsroad_pipeline.pipelines.detector import detector_pipeline

create_pipeline = partial(
    detector_pipeline,
    "hough_forest",
    parameters=HoughForestParameters,
    describe=describe_parts,
    described_by="regions",
    train=train_hough_forest,
)
"""Returns the pipeline: objects to a model, and to detections in the scenes that it was not trained on."""
