"""Random forest on detrended supervoxel features (Tomic et al. 2019, section 2.1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from joblib import cpu_count
from kedro.pipeline import Node, Pipeline
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.core.stage_parameters import (
    FeatureParameters,
    GroundParameters,
    StageParameters,
    SupervoxelParameters,
)
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.tomic2019.detrended_forest.figures import forest_figures
from mlsroad_pipeline.papers.tomic2019.detrended_forest.labeller import label_scene
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import ForestParameters, fit, training_rows
from mlsroad_pipeline.pipelines.per_scene import PerScene
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.pipelines.training_facts import FACTS, describing, with_training_facts
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import held_out_keys, training_keys


def train_forest(
    rows: SceneCollection,
    parameters: ForestParameters,
    ground: GroundParameters,
    supervoxels: SupervoxelParameters,
    features: FeatureParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
    scene_facts: SceneCollection,
) -> tuple[ModelBundle, ModelBundle, Figure, Figure]:
    """Train the forest on the training scenes."""
    bundle, classifier = fit(
        list(rows.load_all().values()),
        parameters=parameters,
        stages=StageParameters(ground, supervoxels, features),
        scheme=training_scheme(survey, classes),
        trained_on={"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(rows)},
        n_jobs=cpu_count(),
    )
    bundle = with_training_facts(bundle, scene_facts)
    return bundle, bundle, *forest_figures(classifier)


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: features to a model, and to labels of the scenes that it was not trained on."""
    prepared = {"scene": "scenes", "supervoxels": "supervoxels", "features": "supervoxel_features"}
    return Pipeline(
        [
            describing(),
            Node(
                PerScene(training_rows, keys=training_keys, scheme=training_scheme),
                {**prepared, "survey": "params:survey", "classes": "params:classes"},
                "detrended_forest.training_set",
                name="take_training_rows",
            ),
            Node(
                train_forest,
                [
                    "detrended_forest.training_set",
                    "params:detrended_forest",
                    "params:ground_removal",
                    "params:supervoxelise",
                    "params:features",
                    "params:survey",
                    "params:classes",
                    FACTS,
                ],
                [
                    "detrended_forest.model",
                    "detrended_forest.registered_model",
                    "detrended_forest.importance_figure",
                    "detrended_forest.oob_figure",
                ],
                name="train_forest",
            ),
            Node(
                PerScene(label_scene, keys=held_out_keys),
                {**prepared, "bundle": "detrended_forest.model"},
                "detrended_forest.labels",
                name="label_scenes",
            ),
        ]
    )
