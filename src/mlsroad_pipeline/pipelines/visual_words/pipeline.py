"""Wiring of the visual words."""

from functools import partial

from mlsroad_pipeline.algorithms.visual_words.descriptions import describe_objects
from mlsroad_pipeline.algorithms.visual_words.training import VisualWordsParameters, train_detector
from mlsroad_pipeline.pipelines.detector import detector_pipeline

create_pipeline = partial(
    detector_pipeline,
    "visual_words",
    parameters=VisualWordsParameters,
    describe=describe_objects,
    described_by="groups",
    train=train_detector,
    parts="groups",
)
"""Returns the pipeline: objects to a model, and to detections in the scenes that it was not trained on."""
