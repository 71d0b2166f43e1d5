"""Training of a superpoint transformer: resumable, bitwise reproducible. Importing this module imports torch."""

from __future__ import annotations

import hashlib
import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.stage_parameters import StageParameters
from mlsroad_pipeline.algorithms.models.bundle import Checkpoints, ModelBundle
from mlsroad_pipeline.algorithms.models.machines.torch_training import (
    find_device,
    learning_rate,
    limited_threads,
    reproducible,
)
from mlsroad_pipeline.algorithms.models.superpoint_transformer.augmentation import change_graph, crop_graph
from mlsroad_pipeline.algorithms.models.superpoint_transformer.building import point_feature_names
from mlsroad_pipeline.algorithms.models.superpoint_transformer.graph import SuperpointGraph, join_graphs
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inputs import (
    Inputs,
    Scale,
    drawn_points,
    find_scale,
    n_inputs,
    prepare_inputs,
)
from mlsroad_pipeline.algorithms.models.superpoint_transformer.network import SuperpointTransformer, to_tensors
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import (
    SLUG,
    SuperpointTransformerParameters,
    TrainingParameters,
)

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Trained:
    """A trained network."""

    network: SuperpointTransformer  # The network, in evaluation mode, on the CPU
    scale: Scale  # Scale of its features
    class_weights: NDArray[np.float32]  # Weights of the classes in the loss; 0 for classes without labelled points
    losses: list[float]  # Loss of each step


def train_network(
    graphs: Sequence[SuperpointGraph],
    *,
    n_classes: int,
    parameters: SuperpointTransformerParameters,
    checkpoints: Checkpoints | None = None,
) -> Trained:
    """Train a network on labelled graphs."""
    labelled = [graph for graph in graphs if graph.levels[0].histogram.sum() > 0]
    if not labelled:
        raise DataError("no labelled points in the training scenes: check the split 'train' and the class scheme")
    training = parameters.training
    run = _Run(labelled, n_classes, parameters)
    name = f"training_{run.identity[:12]}"
    if checkpoints is not None and (state := checkpoints.load(name)) is not None:
        run.restore(state, checkpoints.locate(name))
    saved = time.monotonic()
    with limited_threads(training.n_threads):
        for inputs in _ahead(run, len(run.losses), training.n_steps):
            run.step(inputs)
            if checkpoints is not None and time.monotonic() - saved > training.checkpoint_seconds:
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
        self, graphs: Sequence[SuperpointGraph], n_classes: int, parameters: SuperpointTransformerParameters
    ) -> None:
        self.graphs, self.parameters = graphs, parameters
        self.device = find_device(parameters.training.device)
        self.scale = find_scale(graphs)
        self.class_weights = balance_classes(graphs, parameters.training.class_balance)
        with reproducible(parameters.training.seed):
            self.network = SuperpointTransformer(parameters.network, n_inputs(self.scale), n_classes)
        self.network.to(self.device).train()
        self.optimizer = _optimizer(self.network, parameters.training)
        self.losses: list[float] = []
        self.identity = self._identity(n_classes)

    def _identity(self, n_classes: int) -> str:
        settings = {key: value for key, value in asdict(self.parameters).items() if key != "hierarchy"}
        settings["training"].pop("checkpoint_seconds")
        digest = hashlib.sha256(repr((settings, n_classes)).encode())
        for graph in self.graphs:
            for array in (graph.values, graph.levels[0].centroid, graph.levels[0].histogram):
                digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def batch(self, step: int) -> Inputs:
        """Return the inputs of a step; random numbers depend on the seed and the step only."""
        p = self.parameters
        rng = np.random.default_rng([p.training.seed, step])
        count = p.training.batch_size
        chosen = rng.choice(len(self.graphs), count, replace=count > len(self.graphs))
        parts = [
            change_graph(crop_graph(self.graphs[i], p.training.crop, rng), self.scale, p.augmentation, rng)
            for i in chosen
        ]
        graph = join_graphs(parts)
        return prepare_inputs(graph, self.scale, drawn_points(graph, p.training.n_points, rng))

    def step(self, inputs: Inputs) -> None:
        """Take one gradient step."""
        training = self.parameters.training
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate(len(self.losses), training.n_steps, training.learning_rate)
        batch = to_tensors(inputs, self.device)
        weights = torch.from_numpy(self.class_weights).to(self.device)
        scores = self.network(batch)
        loss = sum_losses(scores, [level.histogram for level in batch.levels], weights, training.level_weights)
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), training.clip)
        self.optimizer.step()
        self.losses.append(float(loss.detach()))
        if len(self.losses) % 100 == 0:
            recent = np.mean(self.losses[-100:])
            logger.info("step %d of %d: loss %.3f", len(self.losses), training.n_steps, recent)

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


def balance_classes(graphs: Sequence[SuperpointGraph], exponent: float) -> NDArray[np.float32]:
    """Return class weights: a power of the inverse share of superpoints, 1 on average; 0 for absent classes."""
    counts = sum(_shares(graph.levels[0].histogram).sum(axis=0) for graph in graphs)
    share = np.asarray(counts, dtype=np.float64) / np.sum(counts)
    weights = np.where(share > 0, np.maximum(share, 1e-5) ** -exponent, 0.0)
    return (weights / (weights * share).sum()).astype(np.float32)


def _shares(histogram: NDArray[np.float32]) -> NDArray[np.float32]:
    return histogram / np.maximum(histogram.sum(axis=1, keepdims=True), 1.0)


def sum_losses(
    scores: Sequence[Tensor], histograms: Sequence[Tensor], class_weights: Tensor, level_weights: Sequence[float]
) -> Tensor:
    """Return the weighted sum over the levels of the cross entropies with the label histograms.

    Superpoints of level 1 count the same. Those of the levels above count as the root of their labelled points.
    """
    total = scores[0].new_zeros(())
    for i, (score, histogram) in enumerate(zip(scores, histograms, strict=True)):
        count = histogram.sum(dim=1, keepdim=True)
        importance = (count > 0).float() if i == 0 else count.sqrt()
        target = histogram / count.clamp(min=1.0) * class_weights * importance
        entropy = -(target * torch.log_softmax(score, dim=1)).sum()
        total = total + level_weights[i] * entropy / target.sum().clamp(min=1e-6)
    return total


def _optimizer(network: nn.Module, training: TrainingParameters) -> torch.optim.AdamW:
    """Return AdamW; biases and normalisation have no weight decay."""
    kernels = [weight for weight in network.parameters() if weight.ndim > 1]
    others = [weight for weight in network.parameters() if weight.ndim <= 1]
    groups = [{"params": kernels, "weight_decay": training.weight_decay}, {"params": others, "weight_decay": 0.0}]
    return torch.optim.AdamW(groups, training.learning_rate)


def fit(
    graphs: Sequence[Mapping[str, NDArray]],
    *,
    parameters: SuperpointTransformerParameters,
    stages: StageParameters,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
    checkpoints: Checkpoints | None = None,
) -> tuple[ModelBundle, list[float]]:
    """Train a network."""
    if not graphs:
        raise DataError("no training scenes: the split 'train' is empty")
    names = graphs[0]["names"].tolist()
    for graph in graphs:
        if graph["names"].tolist() != names:
            raise DataError(
                f"training scenes have different features: {', '.join({*names} ^ {*graph['names'].tolist()})}"
            )
    trained = train_network(
        [SuperpointGraph.from_arrays(graph) for graph in graphs],
        n_classes=len(scheme),
        parameters=parameters,
        checkpoints=checkpoints,
    )
    weights = {f"weights.{name}": value.numpy() for name, value in trained.network.state_dict().items()}
    attributes = [name for name in ("rgb", "intensity") if any(name in graph["attributes"] for graph in graphs)]
    metadata = {
        "classes": list(scheme.classes),
        "scheme": asdict(scheme),
        "parameters": {"superpoint_transformer": asdict(parameters), **asdict(stages)},
        "feature_names": {"points": point_feature_names(parameters.hierarchy), "superpoints": names},
        "attributes": attributes,
        "trained_on": {**trained_on, "graphs": len(graphs)},
        "n_weights": int(sum(value.size for value in weights.values())),
    }
    arrays = {**weights, **trained.scale.to_arrays(), "class_weights": trained.class_weights}
    return ModelBundle(SLUG, arrays, metadata), trained.losses
