"""Gradient-boosted trees on multi-scale voxel features."""

import os
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from joblib import cpu_count
from kedro.pipeline import Pipeline

from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import label_scene
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import SLUG, BoostedTreesParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.sampling import training_voxels
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.pipelines.per_scene import MODEL, named_node, scene_node
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.pipelines.training_facts import describing, labelling, with_training_facts
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import training_keys


def sample_of(own: BoostedTreesParameters) -> BoostedTreesParameters:
    """Return the parameters of the training voxels: those of trees and labels change none."""
    return own.of_sample()


def load_lightgbm() -> None:
    """Import LightGBM with OpenMP threads that sleep while they wait: where cores are shared, others are far slower."""
    given = os.environ.get("OMP_WAIT_POLICY")
    os.environ["OMP_WAIT_POLICY"] = given or "PASSIVE"
    try:
        import_module("lightgbm")
    finally:
        if given is None:
            del os.environ["OMP_WAIT_POLICY"]


def train_boosted_trees(
    voxels: SceneCollection,
    parameters: BoostedTreesParameters,
    ground: GroundParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
    checkpoints: Any,
    scene_facts: SceneCollection,
) -> tuple[ModelBundle, ModelBundle]:
    """Train the trees on the voxels of the training scenes."""
    load_lightgbm()
    model = METHODS[SLUG].load("train")(
        list(voxels.load_all().values()),
        parameters=parameters,
        ground=ground,
        scheme=training_scheme(survey, classes),
        trained_on={"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(voxels)},
        n_threads=cpu_count(),
        checkpoints=checkpoints,
    )
    model = with_training_facts(model, scene_facts)
    return model, model


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: ground to a model, and to labels of the scenes that it was not trained on."""
    own, drawn = f"params:{SLUG}", f"{SLUG}.training_set"
    draw = {"keys": training_keys, "parameters": sample_of, "scheme": training_scheme}
    return Pipeline(
        [
            describing(),
            scene_node(training_voxels, drawn, "draw_training_voxels", inputs={"own": own}, **draw),
            named_node(train_boosted_trees, MODEL, f"train_{SLUG}", slug=SLUG, voxels=drawn),
            labelling(label_scene, SLUG),
        ]
    )
