"""Training of the detrended forest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from joblib import cpu_count
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
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import ForestParameters, fit
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.pipelines.training_facts import with_training_facts
from mlsroad_pipeline.surveys.parameters import SurveyParameters


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
