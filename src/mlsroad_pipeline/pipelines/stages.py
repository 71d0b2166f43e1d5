"""Stages before the methods: ground, supervoxels, their features, patches and objects, with their scores."""

from collections.abc import Callable, Mapping
from typing import Any

import pandas as pd
from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.algorithms import stages
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.segmentation.stage import measure_segmentation, segment_scene, segmentation_table
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, load_all
from mlsroad_pipeline.papers.shared import evaluation
from mlsroad_pipeline.papers.shared.detection.scoring import DetectionParameters, object_classes
from mlsroad_pipeline.papers.shared.patches.labelling import build_patches, label_patches_along
from mlsroad_pipeline.pipelines.per_scene import fix_arguments, named_node, scene_node
from mlsroad_pipeline.pipelines.schemes import detection_scheme, training_scheme
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


def min_points(parameters: DetectionParameters) -> int:
    """Return the least number of points of a reference object."""
    return parameters.min_points


def score_scenes(measured: Mapping[str, Any], *, tabulate: Callable[..., pd.DataFrame]) -> pd.DataFrame:
    """Score a stage per split from the measures of its scenes."""
    return tabulate(load_all(measured))


def _scored(tabulate: Callable[..., pd.DataFrame], measured: str, scores: str, name: str) -> Node:
    return Node(fix_arguments(score_scenes, tabulate=tabulate), measured, scores, name=name)


def _stage(function: Callable[..., Any], output: str, name: str, group: str, **options: Any) -> Node:
    """Return a node with one task per scene and the parameters of a group."""
    return scene_node(function, output, name, inputs={"parameters": f"params:{group}"}, **options)


_STAGES = {
    "ground_removal": [
        _stage(stages.find_ground, "ground", "find_ground_of_scenes", "ground_removal"),
        scene_node(evaluation.count_ground_points, "ground_counts", "count_ground_of_scenes"),
        _scored(evaluation.ground_table, "ground_counts", "ground_scores", "score_ground_removal"),
    ],
    "supervoxelise": [
        _stage(stages.build_supervoxels, "supervoxels", "supervoxelise_scenes", "supervoxelise"),
        scene_node(
            evaluation.measure_supervoxels, "supervoxel_quality_of_scenes", "measure_supervoxels_of_scenes"
        ),
        _scored(
            evaluation.supervoxel_table, "supervoxel_quality_of_scenes", "supervoxel_quality", "score_supervoxels"
        ),
    ],
    "features": [
        _stage(stages.describe_supervoxels, "supervoxel_features", "describe_supervoxels_of_scenes", "features")
    ],
    "patches": [
        _stage(build_patches, "patches", "extract_patches_of_scenes", "patches"),
        named_node(label_training_patches, "patch_labels", "label_patches_of_scenes"),
    ],
    "segmentation": [
        _stage(segment_scene, "objects", "segment_scenes", "segmentation"),
        _stage(
            object_classes, "object_classes", "name_objects_of_scenes", "detection",
            keys=training_keys, scheme=detection_scheme,
        ),
        _stage(
            measure_segmentation, "segmentation_quality_of_scenes", "measure_segmentation_of_scenes", "detection",
            scheme=detection_scheme, min_points=min_points,
        ),
        _scored(segmentation_table, "segmentation_quality_of_scenes", "segmentation_scores", "score_segmentation"),
    ],
}  # fmt: skip
"""Name of each stage, and of its pipeline, to its nodes."""


def create_pipeline(name: str) -> Pipeline:
    """Return the pipeline of a stage, from the scenes and the results of earlier stages to its own."""
    return Pipeline(_STAGES[name])
