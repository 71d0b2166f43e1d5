"""Class probabilities of superpoints by a trained network. Importing this module imports torch."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.graph import SuperpointGraph
from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.inputs import (
    Scale,
    even_points,
    n_inputs,
    prepare_inputs,
)
from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.network import SuperpointTransformer, to_tensors
from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.parameters import (
    SLUG,
    SuperpointTransformerParameters,
)
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.torch_training import load_weights, reproducible


def predict_superpoints(
    graph: SuperpointGraph, bundle: ModelBundle, parameters: SuperpointTransformerParameters
) -> NDArray[np.float32]:
    """Return the probabilities of the network for the superpoints of level 1.

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
        If the weights do not fit the network.
    """
    scale = Scale.from_arrays(bundle.arrays)
    inputs = prepare_inputs(graph, scale, even_points(graph, parameters.training.n_points))
    with reproducible(0), torch.inference_mode():
        scores = _network(bundle, scale, parameters)(to_tensors(inputs, torch.device("cpu")))[0]
        probabilities: NDArray[np.float32] = torch.softmax(scores, dim=1).numpy()
    return probabilities


def _network(bundle: ModelBundle, scale: Scale, parameters: SuperpointTransformerParameters) -> SuperpointTransformer:
    """Return the network of a model; it is built once."""
    if "network" not in bundle.prepared:
        network = SuperpointTransformer(parameters.network, n_inputs(scale), len(bundle.classes))
        load_weights(network, bundle.arrays, "weights.", f"{SLUG} with {len(bundle.classes)} classes")
        bundle.prepared["network"] = network.eval()
    kept: SuperpointTransformer = bundle.prepared["network"]
    return kept
