"""Size, memory and time of the networks of the study of Luo et al. 2019: Tables 1 and 4."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mlsroad_pipeline.algorithms.models.machines.torch_training import reproducible
from mlsroad_pipeline.papers.luo2019.jointnet.inputs import Points, encode
from mlsroad_pipeline.papers.luo2019.jointnet.network import JointNet
from mlsroad_pipeline.papers.luo2019.pointnet.parameters import PointNetParameters
from mlsroad_pipeline.papers.luo2019.pointnet.recogniser import PointNet

POINTS = 1000
"""Points of each timed object."""

STEPS, SECONDS = 20, 4.0
"""Training steps over which times are averaged; fewer where they take more CPU time than this."""


def measure_network(*, parameters: Any, n_classes: int) -> dict[str, NDArray]:
    """Measure one network on one CPU thread with a batch of random objects: its size, memory and times of a step."""
    with reproducible(0):
        network, run = _pointnet(parameters, n_classes) if isinstance(parameters, PointNetParameters) else _jointnet(
            parameters, n_classes
        )  # fmt: skip
        network.train()
        kept: dict[int, int] = {}

        def keep(tensor: Tensor) -> Tensor:
            kept[tensor.untyped_storage().data_ptr()] = tensor.untyped_storage().nbytes()
            return tensor

        with torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor):
            run().backward()
        own = {p.untyped_storage().data_ptr(): p.untyped_storage().nbytes() for p in network.parameters()}
        weights = sum(own.values())
        activations = sum(size for place, size in kept.items() if place not in own)
        forward: list[float] = []
        backward: list[float] = []
        while len(forward) < STEPS and sum(forward) + sum(backward) < SECONDS:
            start = time.process_time()
            loss = run()
            middle = time.process_time()
            loss.backward()
            forward.append(middle - start)
            backward.append(time.process_time() - middle)
    return {
        "weight_bytes": np.array(weights),
        "memory_bytes": np.array(3 * weights + activations),
        "forward_ms": np.array(1000 * np.mean(forward)),
        "backward_ms": np.array(1000 * np.mean(backward)),
    }


Measured = tuple[nn.Module, Callable[[], Tensor]]


def _jointnet(parameters: Any, n_classes: int) -> Measured:
    size, rng = parameters.training.batch_size, np.random.default_rng(0)
    points = Points(
        rng.normal(size=(size * POINTS, 3)),
        np.arange(size + 1) * POINTS,
        rng.random(size * POINTS),
        np.ones(size, bool),
    )
    images, measures = encode(points, parameters.inputs)
    inputs = {view: torch.from_numpy(value) for view, value in images.items()}, torch.from_numpy(measures)
    network = JointNet(parameters, n_classes)
    target = torch.arange(size) % n_classes
    return network, lambda: torch.stack([nn.functional.cross_entropy(head, target) for head in network(*inputs)]).sum()


def _pointnet(parameters: PointNetParameters, n_classes: int) -> Measured:
    points = torch.randn(parameters.batch_size, 3, parameters.n_points)
    network = PointNet(parameters, n_classes)
    target = torch.arange(parameters.batch_size) % n_classes
    return network, lambda: nn.functional.cross_entropy(network(points)[0], target)
