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
    """Name the work that segments each scene's off-ground points.

    Parameters
    ----------
    scenes, ground : SceneCollection
        The scenes and their ground.
    parameters : SegmentationParameters
        The method and its parameters.

    Returns
    -------
    dict of str to SceneTask
        One task per scene.
    """
    return scene_tasks(scenes, segment_scene, {"scene": scenes, "ground": ground}, {"parameters": parameters})


def name_objects_of_scenes(
    scenes: SceneCollection, objects: SceneCollection, detection: DetectionParameters, classes: Mapping[str, Any]
) -> dict[str, SceneTask]:
    """Name the work that gives the objects of each training scene their classes.

    Parameters
    ----------
    scenes, objects : SceneCollection
        The scenes and their objects.
    detection : DetectionParameters
        The wanted classes.
    classes : mapping
        The class schemes.

    Returns
    -------
    dict of str to SceneTask
        One task per scene of the split ``train``.
    """
    parameters = {"scheme": find_scheme(classes["schemes"], detection.scheme), "parameters": detection}
    return scene_tasks(training_keys(scenes), object_classes, {"scene": scenes, "objects": objects}, parameters)


def measure_segmentation_of_scenes(
    scenes: SceneCollection, objects: SceneCollection, detection: DetectionParameters, classes: Mapping[str, Any]
) -> dict[str, SceneTask]:
    """Name the work that compares each scene's objects with its reference instances.

    Parameters
    ----------
    scenes, objects : SceneCollection
        The scenes and their objects.
    detection : DetectionParameters
        The class scheme and the smallest reference object.
    classes : mapping
        The class schemes.

    Returns
    -------
    dict of str to SceneTask
        One task per scene.
    """
    parameters = {"scheme": find_scheme(classes["schemes"], detection.scheme), "min_points": detection.min_points}
    return scene_tasks(scenes, measure_segmentation, {"scene": scenes, "objects": objects}, parameters)


def score_segmentation(measured: SceneCollection) -> pd.DataFrame:
    """Score the segmentation per split.

    Parameters
    ----------
    measured : SceneCollection
        Scores of the scenes.

    Returns
    -------
    DataFrame
        Coverage, precision and recall, over- and under-segmentation.
    """
    return segmentation_table(measured.load_all())
