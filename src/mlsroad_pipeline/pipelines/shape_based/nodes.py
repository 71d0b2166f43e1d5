"""Shapes of objects learned from the training scenes and recognised in the others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mlsroad_pipeline.algorithms.baselines.shape_based import ShapeParameters, fit, training_objects
from mlsroad_pipeline.algorithms.evaluation import find_scheme
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.algorithms.patch_labelling import PatchStages
from mlsroad_pipeline.algorithms.patches import PatchParameters
from mlsroad_pipeline.algorithms.scene_stages import GroundParameters
from mlsroad_pipeline.datasets.method_work import label_prepared_objects
from mlsroad_pipeline.datasets.scene_store import SceneCollection
from mlsroad_pipeline.datasets.scene_task import SceneTask, SourceFile
from mlsroad_pipeline.datasets.survey_plan import SurveyParameters

TRAIN = "train."


def take_training_objects(
    scenes: SceneCollection,
    ground: SceneCollection,
    patches: SceneCollection,
    parameters: ShapeParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> dict[str, SceneTask]:
    """Name the work that cuts the objects out of each training scene.

    Parameters
    ----------
    scenes, ground, patches : SceneCollection
        The scenes and what the stages before gave.
    parameters : ShapeParameters
        How objects are located and cut.
    survey : SurveyParameters
        Names the class scheme.
    classes : mapping
        The class schemes.

    Returns
    -------
    dict of str to SceneTask
        One task per scene of the split ``train``.
    """
    scheme = find_scheme(classes["schemes"], survey.scheme)
    return {
        key: SceneTask(
            training_objects,
            {"scene": scenes[key], "ground": ground[key], "patches": patches[key]},
            {"scheme": scheme, "parameters": parameters},
        )
        for key in scenes
        if key.startswith(TRAIN)
    }


def train_shape_based(
    objects: SceneCollection,
    parameters: ShapeParameters,
    ground: GroundParameters,
    sizes: PatchParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> tuple[ModelBundle, ModelBundle]:
    """Train the forest that classifies objects.

    Parameters
    ----------
    objects : SceneCollection
        Objects of the training scenes with their classes.
    parameters : ShapeParameters
        Parameters of the method.
    ground : GroundParameters
        How the ground was found.
    sizes : PatchParameters
        How patches were cut and described.
    survey : SurveyParameters
        Names the training files and the class scheme.
    classes : mapping
        The class schemes.

    Returns
    -------
    model, registered : ModelBundle
        The model, for the workers and for the registry.
    """
    bundle = fit(
        list(objects.load_all().values()),
        parameters=parameters,
        stages=PatchStages(ground, sizes),
        scheme=find_scheme(classes["schemes"], survey.scheme),
        trained_on={"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(objects)},
    )
    return bundle, bundle


def label_scenes_by_shape(
    scenes: SceneCollection, ground: SceneCollection, patches: SceneCollection, model: SourceFile
) -> dict[str, SceneTask]:
    """Name the work that labels the objects of each scene that the model was not trained on.

    Parameters
    ----------
    scenes, ground, patches : SceneCollection
        The scenes and what the stages before gave.
    model : SourceFile
        The model's folder.

    Returns
    -------
    dict of str to SceneTask
        One task per scene of the other splits.
    """
    return {
        key: SceneTask(
            label_prepared_objects,
            {"scene": scenes[key], "ground": ground[key], "patches": patches[key], "model": model},
        )
        for key in scenes
        if not key.startswith(TRAIN)
    }
