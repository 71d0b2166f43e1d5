"""Training of the multiscale forest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from joblib import cpu_count

from mlsroad_pipeline.algorithms.baselines.multiscale_forest.parameters import SLUG, MultiscaleForestParameters
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.pipelines.training_facts import with_training_facts
from mlsroad_pipeline.surveys.parameters import SurveyParameters


def train_multiscale_forest(
    spheres: SceneCollection,
    parameters: MultiscaleForestParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
    scene_facts: SceneCollection,
) -> tuple[ModelBundle, ModelBundle]:
    """Train the forest on the voxels of the training scenes."""
    model = METHODS[SLUG].load("train")(
        list(spheres.load_all().values()),
        parameters=parameters,
        scheme=training_scheme(survey, classes),
        trained_on={"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(spheres)},
        n_jobs=cpu_count(),
    )
    model = with_training_facts(model, scene_facts)
    return model, model
