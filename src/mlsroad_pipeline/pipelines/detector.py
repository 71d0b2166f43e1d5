"""The pipeline that all detectors share: described objects, a model, detections."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from joblib import cpu_count
from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.detection.detector import DetectionStages
from mlsroad_pipeline.algorithms.detection.scoring import DetectionParameters
from mlsroad_pipeline.algorithms.evaluation.labelling import find_scheme
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters
from mlsroad_pipeline.algorithms.stages import GroundParameters
from mlsroad_pipeline.datasets.scene_store_dataset import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile, scene_tasks
from mlsroad_pipeline.pipelines.method_work import detect_described_objects
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import held_out_keys


def detector_pipeline(
    slug: str,
    *,
    parameters: type,
    describe: Callable[..., Any],
    described_by: str,
    train: Callable[..., ModelBundle],
    parts: str = "parts",
) -> Pipeline:
    """Return the pipeline of a detector: objects to a model, and to detections in the scenes it was not trained on."""

    def describe_objects(scenes: SceneCollection, objects: SceneCollection, parameters: Any) -> dict[str, SceneTask]:
        given = {"parameters": getattr(parameters, described_by)}
        return scene_tasks(scenes, describe, {"scene": scenes, "objects": objects}, given)

    # Kedro reads here which class the parameters become.
    describe_objects.__annotations__["parameters"] = parameters
    stages = ("ground_removal", "segmentation", "detection", "survey", "classes")
    described, model = f"{slug}.{parts}", f"{slug}.model"
    return Pipeline(
        [
            Node(
                describe_objects,
                inputs=["scenes", "objects", f"params:{slug}"],
                outputs=described,
                name=f"describe_objects_of_{slug}",
            ),
            Node(
                _training_node(train, parameters),
                inputs=[described, "object_classes", f"params:{slug}", *(f"params:{name}" for name in stages)],
                outputs=[model, f"{slug}.registered_model"],
                name=f"train_{slug}",
            ),
            Node(_detect_objects, inputs=[described, model], outputs=f"{slug}.detections", name=f"detect_by_{slug}"),
        ]
    )


def _training_node(
    train: Callable[..., ModelBundle], parameters: type
) -> Callable[..., tuple[ModelBundle, ModelBundle]]:
    """Return the node that trains a detector: the model, for the workers and for the registry."""

    def train_model(
        parts: SceneCollection,
        labels: SceneCollection,
        parameters: Any,
        ground: GroundParameters,
        segmentation: SegmentationParameters,
        detection: DetectionParameters,
        survey: SurveyParameters,
        classes: Mapping[str, Any],
    ) -> tuple[ModelBundle, ModelBundle]:
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

    train_model.__annotations__["parameters"] = parameters
    return train_model


def _detect_objects(parts: SceneCollection, model: SourceFile) -> dict[str, SceneTask]:
    """Name the work that detects the objects of each scene that the model was not trained on."""
    return scene_tasks(held_out_keys(parts), detect_described_objects, {"parts": parts, "model": model})
