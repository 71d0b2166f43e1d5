"""The Hough forest, learned on the training scenes; objects detected in the others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from joblib import cpu_count

from mlsroad_pipeline.algorithms.baselines.hough_forest import HoughForestParameters
from mlsroad_pipeline.algorithms.baselines.hough_forest_training import train_hough_forest as train
from mlsroad_pipeline.algorithms.baselines.object_parts import describe_parts
from mlsroad_pipeline.algorithms.detection import DetectionParameters
from mlsroad_pipeline.algorithms.evaluation import find_scheme
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.algorithms.object_detectors import DetectionStages
from mlsroad_pipeline.algorithms.object_segmentation import SegmentationParameters
from mlsroad_pipeline.algorithms.scene_stages import GroundParameters
from mlsroad_pipeline.datasets.method_work import detect_described_objects
from mlsroad_pipeline.datasets.scene_store import SceneCollection
from mlsroad_pipeline.datasets.scene_task import SceneTask, SourceFile
from mlsroad_pipeline.datasets.survey_plan import SurveyParameters

TRAIN = "train."


def describe_objects_of_hough_forest(
    scenes: SceneCollection, objects: SceneCollection, parameters: HoughForestParameters
) -> dict[str, SceneTask]:
    """Name the work that describes each scene's objects by feature regions.

    Parameters
    ----------
    scenes, objects : SceneCollection
        The scenes and their objects.
    parameters : HoughForestParameters
        Parameters of the method.

    Returns
    -------
    dict of str to SceneTask
        One task per scene.
    """
    return {
        key: SceneTask(
            describe_parts, {"scene": scenes[key], "objects": objects[key]}, {"parameters": parameters.regions}
        )
        for key in scenes
    }


def train_hough_forest(
    parts: SceneCollection,
    labels: SceneCollection,
    parameters: HoughForestParameters,
    ground: GroundParameters,
    segmentation: SegmentationParameters,
    detection: DetectionParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> tuple[ModelBundle, ModelBundle]:
    """Train the detector.

    Parameters
    ----------
    parts, labels : SceneCollection
        Parts of the objects of all scenes, and the classes of the objects of the training scenes.
    parameters : HoughForestParameters
        Parameters of the method.
    ground : GroundParameters
        How the ground was found.
    segmentation : SegmentationParameters
        How objects were found.
    detection : DetectionParameters
        The wanted classes.
    survey : SurveyParameters
        Names the training files.
    classes : mapping
        The class schemes.

    Returns
    -------
    model, registered : ModelBundle
        The model, for the workers and for the registry.
    """
    bundle = train(
        {key: parts[key].load() for key in labels},
        labels.load_all(),
        parameters=parameters,
        stages=DetectionStages(ground, segmentation),
        detection=detection,
        scheme=find_scheme(classes["schemes"], detection.scheme),
        trained_on={"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(labels)},
        n_threads=cpu_count(),
    )
    return bundle, bundle


def detect_by_hough_forest(parts: SceneCollection, model: SourceFile) -> dict[str, SceneTask]:
    """Name the work that detects the objects of each scene that the model was not trained on.

    Parameters
    ----------
    parts : SceneCollection
        Parts of the objects of all scenes.
    model : SourceFile
        The model's folder.

    Returns
    -------
    dict of str to SceneTask
        One task per scene of the other splits.
    """
    return {
        key: SceneTask(detect_described_objects, {"parts": parts[key], "model": model})
        for key in parts
        if not key.startswith(TRAIN)
    }
