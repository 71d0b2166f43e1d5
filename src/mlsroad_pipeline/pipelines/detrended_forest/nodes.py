"""The detrended forest trained on the training scenes and applied to the others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from joblib import cpu_count
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.detrended_forest.labeller import StageParameters
from mlsroad_pipeline.algorithms.detrended_forest.training import ForestParameters, fit, training_rows
from mlsroad_pipeline.algorithms.evaluation.labelling import find_scheme
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.stages import FeatureParameters, GroundParameters, SupervoxelParameters
from mlsroad_pipeline.datasets.scene_store_dataset import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile, scene_tasks
from mlsroad_pipeline.pipelines.detrended_forest.work import label_prepared_scene
from mlsroad_pipeline.reporting.figures.forest import forest_figures
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import held_out_keys, training_keys


def take_training_rows(
    scenes: SceneCollection,
    supervoxels: SceneCollection,
    features: SceneCollection,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> dict[str, SceneTask]:
    """Name the work that takes the labelled supervoxels of each training scene."""
    scheme = find_scheme(classes["schemes"], survey.scheme)
    inputs = {"scene": scenes, "supervoxels": supervoxels, "features": features}
    return scene_tasks(training_keys(scenes), training_rows, inputs, {"scheme": scheme})


def train_forest(
    rows: SceneCollection,
    parameters: ForestParameters,
    ground: GroundParameters,
    supervoxels: SupervoxelParameters,
    features: FeatureParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> tuple[ModelBundle, ModelBundle, Figure, Figure]:
    """Train the forest."""
    bundle, classifier = fit(
        list(rows.load_all().values()),
        parameters=parameters,
        stages=StageParameters(ground, supervoxels, features),
        scheme=find_scheme(classes["schemes"], survey.scheme),
        trained_on={"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(rows)},
        n_jobs=cpu_count(),
    )
    return bundle, bundle, *forest_figures(classifier)


def label_scenes(
    scenes: SceneCollection, supervoxels: SceneCollection, features: SceneCollection, model: SourceFile
) -> dict[str, SceneTask]:
    """Name the work that labels each scene that the model was not trained on."""
    inputs = {"scene": scenes, "supervoxels": supervoxels, "features": features, "model": model}
    return scene_tasks(held_out_keys(scenes), label_prepared_scene, inputs)
