"""The network trained on the images of the training drives, and the other drives labelled through theirs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.evaluation.labelling import find_scheme
from mlsroad_pipeline.algorithms.image_labels.training_parameters import ImageLabelsParameters
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.scenes.cutting import IngestParameters
from mlsroad_pipeline.datasets.scene_store_dataset import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile
from mlsroad_pipeline.pipelines.image_labels.work import (
    DriveImages,
    images_of_drives,
    label_scene_through_images,
    scenes_beside,
    train_on_drives,
)
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import held_out_keys, plan_comparison


def find_images(
    scenes: SceneCollection,
    parameters: ImageLabelsParameters,
    survey: SurveyParameters,
    ingest: IngestParameters,
    classes: Mapping[str, Any],
) -> dict[str, DriveImages]:
    """Find the images of each drive."""
    del scenes
    return images_of_drives(plan_comparison(survey, ingest, classes["codings"]), parameters.calibration)


def train_network(
    drives: Mapping[str, DriveImages],
    parameters: ImageLabelsParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> tuple[ModelBundle, ModelBundle, pd.DataFrame]:
    """Train the network on the images of the training drives."""
    scheme = find_scheme(classes["schemes"], survey.scheme)
    trained_on = {"survey": survey.root, "splits": str(survey.splits.get("train"))}
    model, losses = train_on_drives(drives, parameters, scheme, trained_on)
    return model, model, pd.DataFrame({"step": range(len(losses)), "loss": losses})


def label_scenes(
    scenes: SceneCollection, drives: Mapping[str, DriveImages], model: SourceFile, parameters: ImageLabelsParameters
) -> dict[str, SceneTask]:
    """Name the work that labels each scene that the network was not trained on."""
    tasks = {}
    for key in held_out_keys(scenes):
        images = drives.get(SceneKey.parse(key).parent)
        inputs = {
            "scene": scenes[key],
            "around": [scenes[name] for name in scenes_beside(key, scenes)],
            "model": model,
            "calibration": None if images is None else SourceFile(images.calibration),
            "pictures": None if images is None else SourceFile(images.folder),
        }
        tasks[key] = SceneTask(label_scene_through_images, inputs, {"reach": parameters.reach})
    return tasks
