"""Random forest on detrended supervoxel features (Tomic et al. 2019, section 2.1)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from joblib import cpu_count
from kedro.pipeline import Pipeline
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.core.stage_parameters import (
    FeatureParameters,
    GroundParameters,
    StageParameters,
    SupervoxelParameters,
)
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.tomic2019.detrended_forest.labeller import label_scene
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import ForestParameters, fit, training_rows
from mlsroad_pipeline.pipelines.per_scene import MODEL, named_node, scene_node
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.pipelines.training_facts import describing, labelling, with_training_facts
from mlsroad_pipeline.reporting.figures import importance_figure, oob_figure
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.plan import training_keys


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
    bundle, forest = fit(
        list(rows.load_all().values()),
        parameters=parameters,
        stages=StageParameters(ground, supervoxels, features),
        scheme=training_scheme(survey, classes),
        trained_on={"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(rows)},
        n_jobs=cpu_count(),
    )
    bundle = with_training_facts(bundle, scene_facts)
    importances, curve = forest.importances, forest.oob_error
    return (
        bundle,
        bundle,
        importance_figure(list(importances.values()), names=list(importances), title="Feature importances"),
        oob_figure(np.arange(1, len(curve) + 1), curve, chosen=len(curve), title="Out-of-bag error"),
    )


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: features to a model, and to labels of the scenes that it was not trained on."""
    rows, made = "detrended_forest.training_set", (*MODEL, ".importance_figure", ".oob_figure")
    return Pipeline(
        [
            describing(),
            scene_node(training_rows, rows, "take_training_rows", keys=training_keys, scheme=training_scheme),
            named_node(train_forest, made, slug="detrended_forest", rows=rows),
            labelling(label_scene, "detrended_forest", "label_scenes"),
        ]
    )
