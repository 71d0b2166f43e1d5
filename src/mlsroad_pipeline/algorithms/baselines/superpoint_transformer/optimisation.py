"""Optimisation of the network: resumable, bitwise reproducible. Importing this module imports torch."""

from __future__ import annotations

import hashlib
import logging
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.augmentation import change_graph, crop_graph
from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.graph import SuperpointGraph, join_graphs
from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.inputs import (
    Inputs,
    Scale,
    drawn_points,
    find_scale,
    n_inputs,
    prepare_inputs,
)
from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.losses import (
    balance_classes,
    balance_sets,
    share_superpoints,
    sum_losses,
)
from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.network import SuperpointTransformer, to_tensors
from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.parameters import (
    SuperpointTransformerParameters,
    TrainingParameters,
)
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.models.checkpoints import Checkpoints
from mlsroad_pipeline.algorithms.models.torch_training import (
    find_device,
    learning_rate,
    limited_threads,
    reproducible,
)

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Trained:
    """A trained network.

    Attributes
    ----------
    network : SuperpointTransformer
        The network, in evaluation mode, on the CPU.
    scale : Scale
        Scale of its features.
    class_weights : ndarray of float32, shape (classes,)
        Weights of the classes in the loss; 0 for classes without labelled points.
    losses : list of float
        Loss of each step.
    """

    network: SuperpointTransformer
    scale: Scale
    class_weights: NDArray[np.float32]
    losses: list[float]


def train_network(
    graphs: Sequence[SuperpointGraph],
    *,
    n_classes: int,
    parameters: SuperpointTransformerParameters,
    sets: NDArray[np.bool_] | None = None,
    weights: Sequence[float] | None = None,
    checkpoints: Checkpoints | None = None,
) -> Trained:
    """Train a network on labelled graphs.

    Parameters
    ----------
    graphs : sequence of SuperpointGraph
        Graphs of the training scenes, with label histograms.
    n_classes : int
        Number of classes.
    parameters : SuperpointTransformerParameters
        Layers, augmentation and training.
    sets : ndarray of bool, shape (r, n_classes), optional
        Classes that each of the last `r` columns of the histograms allows; the first `n_classes` are the classes.
    weights : sequence of float, optional
        Relative frequency of each graph in the batches; all graphs are equally frequent by default.
    checkpoints : Checkpoints, optional
        Storage of the training state. A saved state of the same training is resumed, and the result is bitwise that of
        an uninterrupted training; it is removed at the end.

    Returns
    -------
    Trained
        The network.

    Raises
    ------
    DataError
        If no graph has a labelled superpoint.
    ReadError
        If the checkpoint is damaged or of another training.
    ParameterError
        If a GPU is requested and none is available.
    """
    labelled = [k for k, graph in enumerate(graphs) if graph.levels[0].histogram.sum() > 0]
    if not labelled:
        raise DataError("no labelled points in the training scenes: check the split 'train' and the class scheme")
    how = parameters.training
    sets = np.empty((0, n_classes), np.bool_) if sets is None else sets
    drawn = None if weights is None else np.asarray(weights, dtype=np.float64)[labelled]
    run = _Run([graphs[k] for k in labelled], sets, drawn, parameters)
    name = f"training_{run.identity[:12]}"
    if checkpoints is not None and (state := checkpoints.load(name)) is not None:
        run.restore(state, checkpoints.locate(name))
    saved = time.monotonic()
    with limited_threads(how.n_threads):
        for inputs in _ahead(run, len(run.losses), how.n_steps):
            run.step(inputs)
            if checkpoints is not None and time.monotonic() - saved > how.checkpoint_seconds:
                checkpoints.save(name, run.state())
                saved = time.monotonic()
    if checkpoints is not None:
        checkpoints.remove(name)
    return run.result()


def _ahead(run: _Run, first: int, n_steps: int) -> Iterator[Inputs]:
    """Yield the batches of the steps, each prepared in a thread during the step before it."""
    with ThreadPoolExecutor(1) as pool:
        drawn = pool.submit(run.batch, first)
        for step in range(first, n_steps):
            inputs = drawn.result()
            if step + 1 < n_steps:
                drawn = pool.submit(run.batch, step + 1)
            yield inputs


class _Run:
    """State of one training, as saved in a checkpoint."""

    def __init__(
        self,
        graphs: Sequence[SuperpointGraph],
        sets: NDArray[np.bool_],
        weights: NDArray[np.float64] | None,
        parameters: SuperpointTransformerParameters,
    ) -> None:
        self.graphs, self.parameters = graphs, parameters
        self.drawn = None if weights is None else weights / weights.sum()
        n_classes = sets.shape[1]
        self.device = find_device(parameters.training.device)
        self.scale = find_scale(graphs)
        shares = share_superpoints(graphs, sets)
        self.class_weights = balance_classes(shares, parameters.training.class_balance)
        weights_of_sets = balance_sets(shares, self.class_weights, sets)
        self.column_weights = torch.from_numpy(np.append(self.class_weights, weights_of_sets)).to(self.device)
        self.sets = torch.from_numpy(sets.astype(np.float32)).to(self.device)
        with reproducible(parameters.training.seed):
            self.network = SuperpointTransformer(parameters.network, n_inputs(self.scale), n_classes)
        self.network.to(self.device).train()
        self.optimizer = _optimizer(self.network, parameters.training)
        self.losses: list[float] = []
        self.identity = self._identity(sets)

    def _identity(self, sets: NDArray[np.bool_]) -> str:
        settings = {key: value for key, value in asdict(self.parameters).items() if key != "hierarchy"}
        settings["training"].pop("checkpoint_seconds")
        drawn = None if self.drawn is None else self.drawn.tolist()
        digest = hashlib.sha256(repr((settings, sets.tolist(), sets.shape, drawn)).encode())
        for graph in self.graphs:
            for array in (graph.values, graph.levels[0].centroid, graph.levels[0].histogram):
                digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def batch(self, step: int) -> Inputs:
        """Return the inputs of a step; random numbers depend on the seed and the step only."""
        p = self.parameters
        rng = np.random.default_rng([p.training.seed, step])
        count = p.training.batch_size
        chosen = rng.choice(len(self.graphs), count, replace=count > len(self.graphs), p=self.drawn)
        parts = [
            change_graph(crop_graph(self.graphs[i], p.training.crop, rng), self.scale, p.augmentation, rng)
            for i in chosen
        ]
        graph = join_graphs(parts)
        return prepare_inputs(graph, self.scale, drawn_points(graph, p.training.n_points, rng))

    def step(self, inputs: Inputs) -> None:
        """Take one gradient step."""
        how = self.parameters.training
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate(len(self.losses), how.n_steps, how.learning_rate)
        batch = to_tensors(inputs, self.device)
        scores = self.network(batch)
        histograms = [level.histogram for level in batch.levels]
        loss = sum_losses(scores, histograms, self.column_weights, how.level_weights, self.sets)
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), how.clip)
        self.optimizer.step()
        self.losses.append(float(loss.detach()))
        if len(self.losses) % 100 == 0:
            recent = np.mean(self.losses[-100:])
            logger.info("step %d of %d: loss %.3f", len(self.losses), how.n_steps, recent)

    def state(self) -> dict[str, Any]:
        """Return the state as tensors and plain values."""
        return {
            "identity": self.identity,
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "losses": self.losses,
        }

    def restore(self, state: dict[str, Any], source: str) -> None:
        """Resume from a saved state; `source` names it in messages."""
        if state.get("identity") != self.identity:
            raise ReadError(f"{source} is a checkpoint of another training; remove it")
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.losses = list(state["losses"])
        logger.info("%s: training resumes after step %d", source, len(self.losses))

    def result(self) -> Trained:
        """Return the trained network."""
        return Trained(self.network.to("cpu").eval(), self.scale, self.class_weights, self.losses)


def _optimizer(network: nn.Module, how: TrainingParameters) -> torch.optim.AdamW:
    """Return AdamW; biases and normalisation have no weight decay."""
    kernels = [weight for weight in network.parameters() if weight.ndim > 1]
    others = [weight for weight in network.parameters() if weight.ndim <= 1]
    groups = [{"params": kernels, "weight_decay": how.weight_decay}, {"params": others, "weight_decay": 0.0}]
    return torch.optim.AdamW(groups, how.learning_rate)
