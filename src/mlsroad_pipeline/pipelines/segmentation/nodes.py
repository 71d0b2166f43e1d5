"""Objects of off-ground points, scene by scene, and their scores."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from mlsroad_pipeline.algorithms.detection.scoring import DetectionParameters, object_classes
from mlsroad_pipeline.algorithms.evaluation.labelling import find_scheme
from mlsroad_pipeline.algorithms.segmentation.stage import (
    SegmentationParameters,
    measure_segmentation,
    segment_scene,
    segmentation_table,
)
from mlsroad_pipeline.datasets.scene_store_dataset import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, scene_tasks
from mlsroad_pipeline.surveys.plan import training_keys


def segment_scenes(
    scenes: SceneCollection, ground: SceneCollection, parameters: SegmentationParameters
) -> dict[str, SceneTask]:
    """Name the work that segments each scene's off-ground points."""
    return scene_tasks(scenes, segment_scene, {"scene": scenes, "ground": ground}, {"parameters": parameters})


def name_objects_of_scenes(
    scenes: SceneCollection, objects: SceneCollection, detection: DetectionParameters, classes: Mapping[str, Any]
) -> dict[str, SceneTask]:
    """Name the work that gives the objects of each training scene their classes."""
    parameters = {"scheme": find_scheme(classes["schemes"], detection.scheme), "parameters": detection}
    return scene_tasks(training_keys(scenes), object_classes, {"scene": scenes, "objects": objects}, parameters)


def measure_segmentation_of_scenes(
    scenes: SceneCollection, objects: SceneCollection, detection: DetectionParameters, classes: Mapping[str, Any]
) -> dict[str, SceneTask]:
    """Name the work that compares each scene's objects with its reference instances."""
    parameters = {"scheme": find_scheme(classes["schemes"], detection.scheme), "min_points": detection.min_points}
    return scene_tasks(scenes, measure_segmentation, {"scene": scenes, "objects": objects}, parameters)


def score_segmentation(measured: SceneCollection) -> pd.DataFrame:
    """Score the segmentation per split."""
    return segmentation_table(measured.load_all())
