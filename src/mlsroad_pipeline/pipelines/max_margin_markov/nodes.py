"""The network trained on the patches of the training scenes."""

from __future__ import annotations

from joblib import cpu_count

from mlsroad_pipeline.algorithms.baselines.max_margin_training import MarginParameters, train
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.pipelines.patch_method import TrainingScenes


def train_max_margin_markov(training: TrainingScenes, parameters: MarginParameters) -> tuple[ModelBundle, ModelBundle]:
    """Train the network.

    Parameters
    ----------
    training : TrainingScenes
        The training scenes.
    parameters : MarginParameters
        Parameters of the network.

    Returns
    -------
    model, registered : ModelBundle
        The model, for the workers and for the registry.
    """
    bundle = train(training.load(), parameters=parameters, n_threads=cpu_count())
    return bundle, bundle
