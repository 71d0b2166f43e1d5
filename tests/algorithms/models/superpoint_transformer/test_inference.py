"""Forward pass in use against the network of the training, and damaged weights."""

import numpy as np
import pytest
import torch

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inference import TrainedNetwork
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inputs import EDGE_FEATURES, Inputs, LevelInputs
from mlsroad_pipeline.algorithms.models.superpoint_transformer.network import SuperpointTransformer, to_tensors
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import NetworkParameters
from mlsroad_pipeline.algorithms.models.superpoint_transformer.weights import weight_shapes

DEFAULT = NetworkParameters()
SMALL = NetworkParameters(
    width=12, point_widths=[5, 7, 6], n_heads=4, key_width=3, edge_width=5, blocks_down=[0, 2, 1], blocks_up=2
)
ONE_HEAD = NetworkParameters(width=8, point_widths=[8], n_heads=1, key_width=1, edge_width=4, blocks_up=0)
N_INPUTS = [19, 30, 18, 18]
N_CLASSES = 5


def trained(parameters, seed=0):
    """Return a network whose normalisations are not the identity, and its weights."""
    torch.manual_seed(seed)
    network = SuperpointTransformer(parameters, N_INPUTS, N_CLASSES).eval()
    with torch.no_grad():
        for values in network.parameters():
            if values.ndim == 1:
                values.add_(torch.randn_like(values), alpha=0.3)
    return network, {name: value.numpy() for name, value in network.state_dict().items()}


def random_level(n, n_parents, n_features, rng, hub=False):
    """Return a level in which each superpoint is its own neighbour, and one a neighbour of all with `hub`."""
    near = np.eye(n, dtype=bool) | (rng.random((n, n)) < min(1.0, 4 / n))
    if hub:
        near[n // 2] = True
    near[0], near[:, 0] = False, False
    near[0, 0] = True  # alone
    target, source = np.nonzero(near)
    return LevelInputs(
        rng.normal(size=(n, n_features)).astype(np.float32),
        rng.normal(size=(len(target), EDGE_FEATURES)).astype(np.float32),
        target,
        source,
        np.concatenate([np.arange(n_parents), rng.integers(0, n_parents, n - n_parents)]),
        np.empty((n, 0), np.float32),
    )


def random_inputs(sizes, *, seed=0, colour=True):
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, 25, sizes[0])
    counts[:: max(sizes[0] // 3, 1)] = 1
    points = rng.normal(size=(counts.sum(), N_INPUTS[0])).astype(np.float32)
    if not colour:
        points[:, 8:11], points[:, 14] = 0.0, 0.0
    levels = tuple(
        random_level(n, parents, n_features, rng, hub=n > 600)
        for n, parents, n_features in zip(sizes, (*sizes[1:], 1), N_INPUTS[1:], strict=True)
    )
    return Inputs(points, np.repeat(np.arange(sizes[0]), counts), levels)


@pytest.mark.parametrize("parameters", [DEFAULT, SMALL, ONE_HEAD])
@pytest.mark.parametrize("sizes", [(1, 1, 1), (2, 2, 1), (37, 9, 3), (700, 90, 4)])
def test_scores_are_those_of_the_network_of_the_training(parameters, sizes):
    network, weights = trained(parameters)
    inputs = random_inputs(sizes, seed=sizes[0], colour=sizes[0] != 37)
    with torch.inference_mode():
        expected = network(to_tensors(inputs, torch.device("cpu")))[0].numpy()
    scores = TrainedNetwork(weights, parameters, N_INPUTS, N_CLASSES).scores(inputs)
    assert scores.dtype == np.float32 and scores.shape == (sizes[0], N_CLASSES)
    assert np.abs(scores - expected).max() < 1e-4


def test_scores_hold_for_large_logits():
    """Logits of some hundreds, whose exponentials overflow; one block, as each one amplifies differences."""
    single = NetworkParameters(n_heads=4, blocks_down=[1, 0, 0], blocks_up=0)
    network, weights = trained(single, seed=3)
    large = {name: values * (20 if name.endswith("node.weight") else 1) for name, values in weights.items()}
    network.load_state_dict({name: torch.from_numpy(values) for name, values in large.items()})
    inputs = random_inputs((50, 8, 2), seed=4)
    with torch.inference_mode():
        expected = network(to_tensors(inputs, torch.device("cpu")))[0].numpy()
    scores = TrainedNetwork(large, single, N_INPUTS, N_CLASSES).scores(inputs)
    assert np.abs(scores - expected).max() < 1e-3


def test_scores_have_the_same_bytes_again():
    _, weights = trained(DEFAULT)
    inputs = random_inputs((700, 90, 4))
    first, again = (TrainedNetwork(weights, DEFAULT, N_INPUTS, N_CLASSES).scores(inputs) for _ in range(2))
    assert first.tobytes() == again.tobytes()


@pytest.mark.parametrize("parameters", [DEFAULT, SMALL, ONE_HEAD])
def test_names_and_shapes_are_those_of_the_network_of_the_training(parameters):
    _, weights = trained(parameters)
    shapes = weight_shapes(parameters, N_INPUTS, N_CLASSES)
    assert shapes == {name: values.shape for name, values in weights.items()}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda w: w.pop("heads.0.bias"), "with 5 classes: Missing heads.0.bias$"),
        (lambda w: w.update({"heads.0.bias": w["heads.0.bias"][1:]}), r"heads.0.bias has the shape \(4,\), not \(5,\)"),
        (lambda w: w.update({"more": np.zeros(1)}), "Unexpected more"),
        (lambda w: w.update({"points.0.bias": w["points.0.bias"] * 1j}), "points.0.bias has the type complex64"),
        (lambda w: w.clear(), "Missing points.0.weight; .*; [0-9]+ more$"),
    ],
)
def test_damaged_weights_are_named(change, message):
    _, weights = trained(SMALL)
    change(weights)
    with pytest.raises(DataError, match=f"the weights do not fit superpoint_transformer.*{message}"):
        TrainedNetwork(weights, SMALL, N_INPUTS, N_CLASSES)
