"""Fusion of the labels by features and through images (Tomic et al. 2019, section 2.3)."""

from collections.abc import Mapping
from typing import Any

from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import with_members
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, scene_tasks
from mlsroad_pipeline.model_store.bundle_files import ModelFile
from mlsroad_pipeline.papers.tomic2019.fusion import labeller as fusion
from mlsroad_pipeline.pipelines.evaluation import evaluate_seen
from mlsroad_pipeline.pipelines.per_scene import MODEL, named_node
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.surveys.parameters import SurveyParameters


def take_test_set_1(
    scenes: SceneCollection,
    features: SceneCollection,
    images: SceneCollection,
    parameters: fusion.FusionParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> dict[str, SceneTask]:
    """Create one task per scene of test set 1: labels of both methods and the reference."""
    first, _ = fusion.divide_scenes(list(images), parameters.share)
    inputs = {"scene": scenes, "features": features, "images": images}
    return scene_tasks(first, fusion.fusion_sample, inputs, {"scheme": training_scheme(survey, classes)})


def learn_fusion(
    answers: SceneCollection,
    features: ModelFile,
    images: ModelFile,
    parameters: fusion.FusionParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> tuple[ModelBundle, ModelBundle]:
    """Train class preferences and weights."""
    members = {"detrended_forest": features.load(), "image_labels": images.load()}
    learned = fusion.fit(
        list(answers.load_all().values()),
        parameters=parameters,
        scheme=training_scheme(survey, classes),
        cameras=members["image_labels"].metadata["cameras"],
        trained_on={"survey": survey.root, "splits": "test set 1", "scenes": len(answers)},
    )
    model = with_members(learned, members)
    return model, model


def fuse_scenes(
    features: SceneCollection, images: SceneCollection, model: ModelFile, parameters: fusion.FusionParameters
) -> dict[str, SceneTask]:
    """Create one task per scene of test set 2."""
    _, second = fusion.divide_scenes(list(images), parameters.share)
    return scene_tasks(second, fusion.fuse_scene, {"features": features, "images": images, "bundle": model})


SLUG = "fusion"
ANSWERS = {
    "fusion": "label",
    "fusion_pool": "pool_label",
    "detrended_forest": "feature_label",
    "image_labels": "image_label",
}
"""Methods scored on test set 2, and the names of their labels in the store."""


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: labels of both methods to a model, trained on test set 1, and scores on test set 2.

    Like `image_labels`, without which it cannot run, it is no part of the comparison.
    """
    labels = {"features": "detrended_forest.labels", "images": "image_labels.labels"}
    models = {"features": "detrended_forest.model", "images": "image_labels.model"}
    return Pipeline(
        [
            named_node(take_test_set_1, ".training_set", slug=SLUG, **labels),
            named_node(learn_fusion, MODEL, slug=SLUG, answers=".training_set", **models),
            named_node(fuse_scenes, ".labels", slug=SLUG, **labels),
            *evaluate_seen(SLUG, ANSWERS, suffix="2"),
        ]
    )
