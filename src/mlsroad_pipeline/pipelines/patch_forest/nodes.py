"""The forest trained on the patches of the training scenes."""

from __future__ import annotations

from joblib import cpu_count

from mlsroad_pipeline.algorithms.baselines.patch_forest import PatchForestParameters, train
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.pipelines.patch_method import TrainingScenes


def train_patch_forest(training: TrainingScenes, parameters: PatchForestParameters) -> tuple[ModelBundle, ModelBundle]:
    """Train the forest.

    Parameters
    ----------
    training : TrainingScenes
        The training scenes.
    parameters : PatchForestParameters
        Parameters of the forest.

    Returns
    -------
    model, registered : ModelBundle
        The model, for the workers and for the registry.
    """
    bundle = train(training.load(), parameters=parameters, n_jobs=cpu_count())
    return bundle, bundle
