"""Patches of scenes, and the classes of the training patches (Luo et al. 2016, section III-A)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.papers.shared.patches.labelling import build_patches, label_patches_along
from mlsroad_pipeline.pipelines.per_scene import PerScene
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import training_keys


def label_training_patches(
    scenes: SceneCollection,
    patches: SceneCollection,
    corridors: SceneCollection,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> dict[str, SceneTask]:
    """Create one task per training scene that finds the classes and stations of its patches."""
    scheme = training_scheme(survey, classes)
    drives = {key: corridors[SceneKey.parse(key).parent] for key in training_keys(scenes)}
    return {
        key: SceneTask(
            label_patches_along,
            {"scene": scenes[key], "patches": patches[key], "corridor": corridor},
            {"scheme": scheme},
        )
        for key, corridor in drives.items()
    }


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: scenes and ground to patches, and to the classes of those of the training scenes."""
    return Pipeline(
        [
            Node(
                PerScene(build_patches),
                {"scene": "scenes", "ground": "ground", "parameters": "params:patches"},
                "patches",
                name="extract_patches_of_scenes",
            ),
            Node(
                label_training_patches,
                ["scenes", "patches", "corridors", "params:survey", "params:classes"],
                "patch_labels",
                name="label_patches_of_scenes",
            ),
        ]
    )
