"""Patches, scene by scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mlsroad_pipeline.algorithms.evaluation.labelling import find_scheme
from mlsroad_pipeline.algorithms.patches.extraction import PatchParameters
from mlsroad_pipeline.algorithms.patches.labelling import build_patches, label_patches
from mlsroad_pipeline.datasets.scene_store_dataset import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, scene_tasks
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import training_keys


def extract_patches_of_scenes(
    scenes: SceneCollection, ground: SceneCollection, parameters: PatchParameters
) -> dict[str, SceneTask]:
    """Name the work that cuts each scene into patches."""
    return scene_tasks(scenes, build_patches, {"scene": scenes, "ground": ground}, {"parameters": parameters})


def label_patches_of_scenes(
    scenes: SceneCollection, patches: SceneCollection, survey: SurveyParameters, classes: Mapping[str, Any]
) -> dict[str, SceneTask]:
    """Name the work that gives the patches of each training scene their classes."""
    scheme = find_scheme(classes["schemes"], survey.scheme)
    return scene_tasks(training_keys(scenes), label_patches, {"scene": scenes, "patches": patches}, {"scheme": scheme})
