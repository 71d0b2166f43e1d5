"""Training of shape-based recognition."""

from __future__ import annotations

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.luo2016.shape_based.labeller import ShapeParameters
from mlsroad_pipeline.papers.luo2016.shape_based.training import fit
from mlsroad_pipeline.pipelines.patch_labellers import TrainingScenes


def scheme_of(training: TrainingScenes) -> ClassScheme:
    """Return the classes that the method is trained on."""
    return training.scheme


def train_shape_based(
    training: TrainingScenes, parameters: ShapeParameters, objects: SceneCollection
) -> tuple[ModelBundle, ModelBundle]:
    """Train the forest that classifies objects."""
    bundle = fit(
        list(objects.load_all().values()),
        parameters=parameters,
        stages=training.stages,
        scheme=training.scheme,
        trained_on=training.trained_on,
    )
    return bundle, bundle
