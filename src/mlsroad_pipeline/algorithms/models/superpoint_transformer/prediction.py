"""Class probabilities of superpoints by a trained network."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]  # it has no stubs

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under
from mlsroad_pipeline.algorithms.models.superpoint_transformer.graph import SuperpointGraph
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inference import TrainedNetwork
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inputs import (
    Scale,
    even_points,
    n_inputs,
    prepare_inputs,
)
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import (
    SuperpointTransformerParameters,
)


def predict_superpoints(
    graph: SuperpointGraph, bundle: ModelBundle, parameters: SuperpointTransformerParameters
) -> NDArray[np.float32]:
    """Return the probabilities of the network for the superpoints of level 1."""
    scale = Scale.from_arrays(bundle.arrays)
    network = _network(bundle, scale, parameters)
    inputs = prepare_inputs(graph, scale, even_points(graph, parameters.training.n_points))
    # One thread: results do not depend on their number. NaN from damaged weights reaches the check of the labels.
    with _libraries().limit(limits=1, user_api="blas"), np.errstate(invalid="ignore", over="ignore"):
        scores = network.scores(inputs)
        weights = np.exp(scores - scores.max(axis=1, keepdims=True))
        probabilities: NDArray[np.float32] = weights / weights.sum(axis=1, keepdims=True)
    return probabilities


@functools.lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    """Return the thread pools of the loaded libraries; finding them takes 2 ms."""
    return ThreadpoolController()


def _network(bundle: ModelBundle, scale: Scale, parameters: SuperpointTransformerParameters) -> TrainedNetwork:
    """Return the network of a model; it is built once."""
    if "network" not in bundle.prepared:
        weights = arrays_under(bundle.arrays, "weights.")
        network = TrainedNetwork(weights, parameters.network, n_inputs(scale), len(bundle.classes))
        bundle.prepared["network"] = network
    kept: TrainedNetwork = bundle.prepared["network"]
    return kept
