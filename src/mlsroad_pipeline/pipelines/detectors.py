"""Pipelines of detectors: described objects, a model, and detections in the scenes that it was not trained on."""

# Annotations are evaluated: Kedro reads from them the class of the parameters, which differs between methods.
from collections.abc import Callable, Mapping
from typing import Any

from joblib import cpu_count
from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.core.classes import find_scheme
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS, Method
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, scene_tasks
from mlsroad_pipeline.papers.shared.detection.detector import DetectionStages, detect_objects
from mlsroad_pipeline.papers.shared.detection.scoring import DetectionParameters
from mlsroad_pipeline.papers.shared.detection.training import DetectorTraining
from mlsroad_pipeline.pipelines.per_scene import MODEL, named_node, scene_node
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import held_out_keys


def create_pipeline(slug: str) -> Pipeline:
    """Return the pipeline of a detector."""
    method = METHODS[slug]
    described, model = f"{slug}.{method.described}", f"{slug}.model"
    return Pipeline(
        [
            named_node(_description(method), described, f"describe_objects_of_{slug}", slug=slug),
            named_node(_training(method), MODEL, f"train_{slug}", slug=slug, parts=described, labels="object_classes"),
            scene_node(
                detect_objects,
                f"{slug}.detections",
                f"detect_by_{slug}",
                inputs={"parts": described, "bundle": model},
                keys=held_out_keys,
            ),
        ]
    )


def _description(method: Method) -> Callable[..., dict[str, SceneTask]]:
    """Return the node function that describes the objects of each scene."""
    kind: Any = method.load("parameters")

    def describe_objects(scenes: SceneCollection, objects: SceneCollection, parameters: kind) -> dict[str, SceneTask]:
        """Create one task per scene."""
        fixed = {"parameters": getattr(parameters, method.description)}
        return scene_tasks(scenes, method.load("describe"), {"scene": scenes, "objects": objects}, fixed)

    return describe_objects


def _training(method: Method) -> Callable[..., tuple[ModelBundle, ModelBundle]]:
    """Return the node function that trains a detector; it returns the model for workers and for the registry."""
    kind: Any = method.load("parameters")

    def train_detector(
        parts: SceneCollection,
        labels: SceneCollection,
        parameters: kind,
        ground: GroundParameters,
        segmentation: SegmentationParameters,
        detection: DetectionParameters,
        survey: SurveyParameters,
        classes: Mapping[str, Any],
    ) -> tuple[ModelBundle, ModelBundle]:
        """Train the detector on the training scenes."""
        stages, scheme = DetectionStages(ground, segmentation), find_scheme(classes["schemes"], detection.scheme)
        facts = {"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(labels)}
        training = DetectorTraining(method.slug, parameters, stages, detection, scheme, facts, cpu_count())
        bundle = method.load("train")({key: parts[key].load() for key in labels}, labels.load_all(), training)
        return bundle, bundle

    return train_detector
