"""Which method and which camera to believe, learned on test set 1; test set 2 fused."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mlsroad_pipeline.algorithms.evaluation.labelling import find_scheme
from mlsroad_pipeline.algorithms.fusion.labeller import FusionParameters, divide_scenes, fit, fusion_sample
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.members import with_members
from mlsroad_pipeline.datasets.models.model_bundle_dataset import open_model
from mlsroad_pipeline.datasets.scene_store_dataset import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile, scene_tasks
from mlsroad_pipeline.pipelines.fusion.work import fuse_labelled_scene
from mlsroad_pipeline.surveys.parameters import SurveyParameters


def take_test_set_1(
    scenes: SceneCollection,
    features: SceneCollection,
    images: SceneCollection,
    parameters: FusionParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> dict[str, SceneTask]:
    """Name the work that takes what is learned from each scene of test set 1."""
    scheme = find_scheme(classes["schemes"], survey.scheme)
    first, _ = divide_scenes(list(images), parameters.share)
    inputs = {"scene": scenes, "features": features, "images": images}
    return scene_tasks(first, fusion_sample, inputs, {"scheme": scheme})


def learn_fusion(
    answers: SceneCollection,
    features: SourceFile,
    images: SourceFile,
    parameters: FusionParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> tuple[ModelBundle, ModelBundle]:
    """Learn preferences and weights."""
    members = {"detrended_forest": open_model(features.path), "image_labels": open_model(images.path)}
    learned = fit(
        list(answers.load_all().values()),
        parameters=parameters,
        scheme=find_scheme(classes["schemes"], survey.scheme),
        cameras=members["image_labels"].metadata["cameras"],
        trained_on={"survey": survey.root, "splits": "test set 1", "scenes": len(answers)},
    )
    model = with_members(learned, members)
    return model, model


def fuse_scenes(
    features: SceneCollection, images: SceneCollection, model: SourceFile, parameters: FusionParameters
) -> dict[str, SceneTask]:
    """Name the work that fuses the labels of each scene of test set 2."""
    _, second = divide_scenes(list(images), parameters.share)
    return scene_tasks(second, fuse_labelled_scene, {"features": features, "images": images, "model": model})
