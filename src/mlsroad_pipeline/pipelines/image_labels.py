"""Labels of points through camera images (Tomic et al. 2019, section 2.2)."""

from collections.abc import Iterable, Mapping
from typing import Any

import pandas as pd
from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.algorithms.scenes.parameters import IngestParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile
from mlsroad_pipeline.model_store.bundle_files import ModelFile
from mlsroad_pipeline.papers.tomic2019.image_labels.drive_images import (
    DriveImages,
    LabelledImages,
    images_of_drives,
    label_scene_through_images,
)
from mlsroad_pipeline.papers.tomic2019.image_labels.own_segmentation import own_model
from mlsroad_pipeline.papers.tomic2019.image_labels.training_parameters import ImageLabelsParameters
from mlsroad_pipeline.pipelines.evaluation import evaluate_seen
from mlsroad_pipeline.pipelines.per_scene import MODEL, named_node
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.surveys.masks import masks_of_passes
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import held_out_keys, plan_comparison, training_keys


def find_images(
    scenes: SceneCollection,
    parameters: ImageLabelsParameters,
    survey: SurveyParameters,
    ingest: IngestParameters,
    classes: Mapping[str, Any],
) -> dict[str, DriveImages]:
    """Find the images of each drive that has scenes."""
    drives = {SceneKey.parse(key).parent for key in scenes}
    plan = plan_comparison(survey, ingest, classes["codings"])
    found = images_of_drives(plan, parameters.calibration, drives, training=not parameters.own_segmentation)
    if parameters.masks is not None:
        masks_of_passes({drive: images.images for drive, images in found.items()}, parameters.masks)
    return found


def train_network(
    drives: Mapping[str, DriveImages],
    parameters: ImageLabelsParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> tuple[ModelBundle, ModelBundle, pd.DataFrame]:
    """Train the network on the images of the training drives, or take one trained elsewhere, or masks."""
    scheme = training_scheme(survey, classes)
    cameras = sorted({group for images in drives.values() for group in images.images.groups})
    if parameters.own_segmentation:
        model = own_model(parameters, scheme, cameras=cameras, trained_on={"survey": survey.root})
        return model, model, pd.DataFrame({"step": pd.Series(dtype="int64"), "loss": pd.Series(dtype="float64")})
    model, losses = METHODS["image_labels"].load("train")(
        LabelledImages([drives[drive] for drive in training_keys(drives)], parameters.labels, scheme),
        parameters=parameters,
        scheme=scheme,
        cameras=cameras,
        trained_on={"survey": survey.root, "splits": str(survey.splits.get("train"))},
    )
    return model, model, pd.DataFrame({"step": range(len(losses)), "loss": losses})


def label_scenes(
    scenes: SceneCollection, drives: Mapping[str, DriveImages], model: ModelFile, parameters: ImageLabelsParameters
) -> dict[str, SceneTask]:
    """Create one task per held-out scene."""
    tasks = {}
    for key in held_out_keys(scenes):
        images = drives.get(SceneKey.parse(key).parent)
        inputs = {
            "scene": scenes[key],
            "around": [scenes[name] for name in scenes_beside(key, scenes)],
            "model": model,
            "calibration": None if images is None else SourceFile(images.calibration),
            "pictures": None if images is None else SourceFile(images.folder_of(parameters.masks)),
        }
        tasks[key] = SceneTask(label_scene_through_images, inputs, {"reach": parameters.reach})
    return tasks


def scenes_beside(key: str, keys: Iterable[str]) -> list[str]:
    """Return the keys of the scenes before and after a scene on its drive."""
    drive = [name for name in keys if SceneKey.parse(name).parent == SceneKey.parse(key).parent]
    place = drive.index(key)
    return [*drive[max(place - 1, 0) : place], *drive[place + 1 : place + 2]]


SLUG = "image_labels"


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes and images to a model, labels of the scenes that it was not trained on, and scores.

    It is no part of the comparison: only surveys with images have it, and training a network takes minutes.
    """
    drives = f"{SLUG}.drives"
    return Pipeline(
        [
            named_node(find_images, drives, slug=SLUG),
            named_node(train_network, [*MODEL, ".objective"], slug=SLUG, drives=drives),
            named_node(label_scenes, ".labels", "label_through_images", slug=SLUG, drives=drives),
            *evaluate_seen(SLUG, {SLUG: "label"}),
        ]
    )
