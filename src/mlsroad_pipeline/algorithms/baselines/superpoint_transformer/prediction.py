"""Class probabilities of superpoints by a trained network."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]  # it has no stubs

from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.graph import SuperpointGraph
from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.inference import TrainedNetwork
from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.inputs import (
    Scale,
    even_points,
    n_inputs,
    prepare_inputs,
)
from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.parameters import (
    SuperpointTransformerParameters,
)
from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.weights import weight_prefixes
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under


def predict_superpoints(
    graph: SuperpointGraph, bundle: ModelBundle, parameters: SuperpointTransformerParameters
) -> NDArray[np.float32]:
    """Return the probabilities of the superpoints of level 1 by the mean of the scores of the networks.

    Parameters
    ----------
    graph : SuperpointGraph
        The graph of a scene.
    bundle : ModelBundle
        A model of `training.fit`.
    parameters : SuperpointTransformerParameters
        Its parameters.

    Returns
    -------
    ndarray of float32, shape (n, classes)
        Probabilities under the class weights of the training.

    Raises
    ------
    DataError
        If the weights do not fit the network, or the scale does not fit the features.
    """
    scale = Scale.from_arrays(bundle.arrays)
    networks = _networks(bundle, scale, parameters)
    inputs = prepare_inputs(graph, scale, even_points(graph, parameters.training.n_points))
    # One thread: results do not depend on their number. NaN from damaged weights reaches the check of the labels.
    with _libraries().limit(limits=1, user_api="blas"), np.errstate(invalid="ignore", over="ignore"):
        scores = np.mean([network.scores(inputs) for network in networks], axis=0)
        weights = np.exp(scores - scores.max(axis=1, keepdims=True))
        probabilities: NDArray[np.float32] = weights / weights.sum(axis=1, keepdims=True)
    return probabilities


@functools.lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    """Return the thread pools of the loaded libraries; finding them takes 2 ms."""
    return ThreadpoolController()


def _networks(bundle: ModelBundle, scale: Scale, parameters: SuperpointTransformerParameters) -> list[TrainedNetwork]:
    """Return the networks of a model; they are built once."""
    if "networks" not in bundle.prepared:
        bundle.prepared["networks"] = [
            TrainedNetwork(
                arrays_under(bundle.arrays, prefix), parameters.network, n_inputs(scale), len(bundle.classes)
            )
            for prefix in weight_prefixes(parameters.training.n_networks)
        ]
    kept: list[TrainedNetwork] = bundle.prepared["networks"]
    return kept
