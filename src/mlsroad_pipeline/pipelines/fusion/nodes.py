"""Training of the fusion on test set 1, and fused labels of test set 2."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.members import with_members
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, scene_tasks
from mlsroad_pipeline.model_store.bundle_files import ModelFile
from mlsroad_pipeline.papers.tomic2019.fusion.labeller import (
    FusionParameters,
    divide_scenes,
    fit,
    fuse_scene,
    fusion_sample,
)
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.surveys.parameters import SurveyParameters


def take_test_set_1(
    scenes: SceneCollection,
    features: SceneCollection,
    images: SceneCollection,
    parameters: FusionParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> dict[str, SceneTask]:
    """Create one task per scene of test set 1: labels of both methods and the reference."""
    first, _ = divide_scenes(list(images), parameters.share)
    inputs = {"scene": scenes, "features": features, "images": images}
    return scene_tasks(first, fusion_sample, inputs, {"scheme": training_scheme(survey, classes)})


def learn_fusion(
    answers: SceneCollection,
    features: ModelFile,
    images: ModelFile,
    parameters: FusionParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> tuple[ModelBundle, ModelBundle]:
    """Train class preferences and weights."""
    members = {"detrended_forest": features.load(), "image_labels": images.load()}
    learned = fit(
        list(answers.load_all().values()),
        parameters=parameters,
        scheme=training_scheme(survey, classes),
        cameras=members["image_labels"].metadata["cameras"],
        trained_on={"survey": survey.root, "splits": "test set 1", "scenes": len(answers)},
    )
    model = with_members(learned, members)
    return model, model


def fuse_scenes(
    features: SceneCollection, images: SceneCollection, model: ModelFile, parameters: FusionParameters
) -> dict[str, SceneTask]:
    """Create one task per scene of test set 2."""
    _, second = divide_scenes(list(images), parameters.share)
    return scene_tasks(second, fuse_scene, {"features": features, "images": images, "bundle": model})
