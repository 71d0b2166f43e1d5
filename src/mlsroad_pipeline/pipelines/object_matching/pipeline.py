"""Wiring of the object matching."""

from functools import partial

from mlsroad_pipeline.algorithms.baselines.object_matching.detector import ObjectMatchingParameters
from mlsroad_pipeline.algorithms.baselines.object_matching.training import train_object_matching
from mlsroad_pipeline.algorithms.detection.parts import describe_parts
from mlsroad_pipeline.pipelines.detector import detector_pipeline

create_pipeline = partial(
    detector_pipeline,
    "object_matching",
    parameters=ObjectMatchingParameters,
    describe=describe_parts,
    described_by="regions",
    train=train_object_matching,
)
"""Returns the pipeline: objects to a model, and to detections in the scenes that it was not trained on."""
