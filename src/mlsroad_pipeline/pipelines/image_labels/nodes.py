"""The network trained on the images of the training drives, and the other drives labelled through theirs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

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
    """Find the images of each drive.

    Parameters
    ----------
    scenes : SceneCollection
        The scenes; only that they are there counts.
    parameters : ImageLabelsParameters
        Name of the file of cameras.
    survey : SurveyParameters
        Names the files.
    ingest : IngestParameters
        How they were cut.
    classes : mapping
        The class schemes and codings.

    Returns
    -------
    dict of str to DriveImages
        Drive to its images.

    Raises
    ------
    ReadError
        If the training drives have no images.
    """
    del scenes
    return images_of_drives(plan_comparison(survey, ingest, classes["codings"]), parameters.calibration)


def train_network(
    drives: Mapping[str, DriveImages],
    parameters: ImageLabelsParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> tuple[ModelBundle, ModelBundle, pd.DataFrame]:
    """Train the network on the images of the training drives.

    Parameters
    ----------
    drives : mapping of str to DriveImages
        Drive to its images.
    parameters : ImageLabelsParameters
        How.
    survey : SurveyParameters
        Names the training files and the class scheme.
    classes : mapping
        The class schemes.

    Returns
    -------
    model, registered : ModelBundle
        The model, for the workers and for the registry.
    losses : DataFrame
        Loss of every step.
    """
    scheme = find_scheme(classes["schemes"], survey.scheme)
    trained_on = {"survey": survey.root, "splits": str(survey.splits.get("train"))}
    model, losses = train_on_drives(drives, parameters, scheme, trained_on)
    return model, model, pd.DataFrame({"step": range(len(losses)), "loss": losses})


def label_scenes(
    scenes: SceneCollection, drives: Mapping[str, DriveImages], model: SourceFile, parameters: ImageLabelsParameters
) -> dict[str, SceneTask]:
    """Name the work that labels each scene that the network was not trained on.

    Parameters
    ----------
    scenes : SceneCollection
        The scenes.
    drives : mapping of str to DriveImages
        Drive to its images.
    model : SourceFile
        The model's folder.
    parameters : ImageLabelsParameters
        Which images are looked at.

    Returns
    -------
    dict of str to SceneTask
        One task per scene of the other splits.
    """
    tasks = {}
    for key in held_out_keys(scenes):
        images = drives.get(key.rpartition(".")[0])
        inputs = {
            "scene": scenes[key],
            "around": [scenes[name] for name in scenes_beside(key, scenes)],
            "model": model,
            "calibration": None if images is None else SourceFile(images.calibration),
            "pictures": None if images is None else SourceFile(images.folder),
        }
        tasks[key] = SceneTask(label_scene_through_images, inputs, {"reach": parameters.reach})
    return tasks
