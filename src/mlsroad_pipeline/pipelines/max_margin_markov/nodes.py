"""The network trained on the patches of the training scenes and applied to the others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mlsroad_pipeline.algorithms.baselines.max_margin_markov import (
    ENTRY_POINT,
    SLUG,
    MarginParameters,
    MaxMarginMarkov,
)
from mlsroad_pipeline.algorithms.evaluation import find_scheme
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.algorithms.patch_labelling import PatchStages, bundle_model, join_training_scenes
from mlsroad_pipeline.algorithms.patches import PatchParameters
from mlsroad_pipeline.algorithms.scene_stages import GroundParameters
from mlsroad_pipeline.datasets.method_work import label_prepared_patches
from mlsroad_pipeline.datasets.scene_store import SceneCollection
from mlsroad_pipeline.datasets.scene_task import SceneTask, SourceFile
from mlsroad_pipeline.datasets.survey_plan import SurveyParameters

TRAIN = "train."


def train_max_margin_markov(
    patches: SceneCollection,
    patch_labels: SceneCollection,
    parameters: MarginParameters,
    ground: GroundParameters,
    sizes: PatchParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> tuple[ModelBundle, ModelBundle]:
    """Train the network.

    Parameters
    ----------
    patches, patch_labels : SceneCollection
        Patches of all scenes, and the classes of those of the training scenes.
    parameters : MarginParameters
        Parameters of the network.
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
    scheme = find_scheme(classes["schemes"], survey.scheme)
    training = join_training_scenes({key: patches[key].load() for key in patch_labels}, patch_labels.load_all())
    classifier = MaxMarginMarkov.fit(*training, parameters=parameters, n_classes=len(scheme))
    bundle = bundle_model(
        SLUG,
        classifier,
        training[0],
        entry_point=ENTRY_POINT,
        parameters=parameters,
        stages=PatchStages(ground, sizes),
        scheme=scheme,
        trained_on={"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(patch_labels)},
    )
    return bundle, bundle


def label_scenes_by_max_margin_markov(
    scenes: SceneCollection, patches: SceneCollection, model: SourceFile
) -> dict[str, SceneTask]:
    """Name the work that labels each scene that the model was not trained on.

    Parameters
    ----------
    scenes, patches : SceneCollection
        The scenes and their patches.
    model : SourceFile
        The model's folder.

    Returns
    -------
    dict of str to SceneTask
        One task per scene of the other splits.
    """
    return {
        key: SceneTask(
            label_prepared_patches,
            {"scene": scenes[key], "patches": patches[key], "model": model},
            {"classifier": MaxMarginMarkov},
        )
        for key in scenes
        if not key.startswith(TRAIN)
    }
