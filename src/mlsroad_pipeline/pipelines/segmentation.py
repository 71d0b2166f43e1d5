"""Segmentation of off-ground points into objects."""

from __future__ import annotations

import pandas as pd
from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.segmentation.stage import measure_segmentation, segment_scene, segmentation_table
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.shared.detection.scoring import DetectionParameters, object_classes
from mlsroad_pipeline.pipelines.per_scene import PerScene
from mlsroad_pipeline.pipelines.schemes import detection_scheme
from mlsroad_pipeline.surveys.plan import training_keys


def min_points(parameters: DetectionParameters) -> int:
    """Return the least number of points of a reference object."""
    return parameters.min_points


def score_segmentation(measured: SceneCollection) -> pd.DataFrame:
    """Score the segmentation per split."""
    return segmentation_table(measured.load_all())


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes and their ground to objects, and the scores of the segmentation."""
    inputs = {"scene": "scenes", "objects": "objects", "parameters": "params:detection", "classes": "params:classes"}
    return Pipeline(
        [
            Node(
                PerScene(segment_scene),
                {"scene": "scenes", "ground": "ground", "parameters": "params:segmentation"},
                "objects",
                name="segment_scenes",
            ),
            Node(
                PerScene(object_classes, keys=training_keys, scheme=detection_scheme),
                inputs,
                "object_classes",
                name="name_objects_of_scenes",
            ),
            Node(
                PerScene(measure_segmentation, scheme=detection_scheme, min_points=min_points),
                inputs,
                "segmentation_quality_of_scenes",
                name="measure_segmentation_of_scenes",
            ),
            Node(
                score_segmentation, "segmentation_quality_of_scenes", "segmentation_scores", name="score_segmentation"
            ),
        ]
    )
