"""The machine trained on the patches of the training scenes and applied to the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from joblib import cpu_count

from mlsroad_pipeline.algorithms.baselines.patch_svm import ENTRY_POINT, SLUG, PatchSvm, PatchSvmParameters
from mlsroad_pipeline.algorithms.baselines.patch_svm_training import fit_patch_svm
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


def train_patch_svm(
    patches: SceneCollection,
    patch_labels: SceneCollection,
    parameters: PatchSvmParameters,
    ground: GroundParameters,
    sizes: PatchParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> tuple[ModelBundle, ModelBundle]:
    """Train the machine.

    Parameters
    ----------
    patches, patch_labels : SceneCollection
        Patches of all scenes, and the classes of those of the training scenes.
    parameters : PatchSvmParameters
        Parameters of the machine.
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
    classifier, choice = fit_patch_svm(*training, parameters=parameters, n_classes=len(scheme), n_jobs=cpu_count())
    bundle = bundle_model(
        SLUG,
        classifier,
        training[0],
        entry_point=ENTRY_POINT,
        parameters=parameters,
        stages=PatchStages(ground, sizes),
        scheme=scheme,
        trained_on={"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(patch_labels)},
        facts={"chosen": asdict(choice)},
    )
    return bundle, bundle


def label_scenes_by_patch_svm(
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
            {"classifier": PatchSvm},
        )
        for key in scenes
        if not key.startswith(TRAIN)
    }
