"""The machine trained on the patches of the training scenes."""

from __future__ import annotations

from joblib import cpu_count

from mlsroad_pipeline.algorithms.baselines.patch_svm import PatchSvmParameters
from mlsroad_pipeline.algorithms.baselines.patch_svm_training import train
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.pipelines.patch_method import TrainingScenes


def train_patch_svm(training: TrainingScenes, parameters: PatchSvmParameters) -> tuple[ModelBundle, ModelBundle]:
    """Train the machine.

    Parameters
    ----------
    training : TrainingScenes
        The training scenes.
    parameters : PatchSvmParameters
        Parameters of the machine.

    Returns
    -------
    model, registered : ModelBundle
        The model, for the workers and for the registry.
    """
    bundle = train(training.load(), parameters=parameters, n_jobs=cpu_count())
    return bundle, bundle
