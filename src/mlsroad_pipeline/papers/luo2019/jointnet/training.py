"""Training of JointNet: resumable, bitwise reproducible stochastic gradient descent."""

import logging
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from tqdm import tqdm

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.models.bundle import Checkpoints
from mlsroad_pipeline.algorithms.models.machines.torch_training import (
    find_device,
    learning_rate,
    reproducible,
)
from mlsroad_pipeline.papers.luo2019.jointnet.inputs import Points, augment, encode
from mlsroad_pipeline.papers.luo2019.jointnet.network import JointNet
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import JointNetParameters, TrainingParameters

HALVE_EVERY = 20
"""Epochs after which the schedule "halving" halves the learning rate (luo2019, training details)."""

SETTLE = 4
"""Passes over the training objects after the last epoch that estimate the statistics of batch normalisation."""

_SETTLE_BATCH = 128

logger = logging.getLogger(__name__)


def scheduled_rate(step: int, n_steps: int, epoch: int, p: TrainingParameters) -> float:
    """Return the learning rate of a step."""
    if p.schedule == "halving":
        return p.learning_rate * float(0.5 ** (epoch // HALVE_EVERY))
    return learning_rate(step, n_steps, p.learning_rate)


def to_tensors(
    images: dict[str, NDArray[np.float32]], measures: NDArray[np.float32], device: torch.device
) -> tuple[dict[str, Tensor], Tensor]:
    """Move the encoded objects to a device."""
    return {view: torch.from_numpy(v).to(device) for view, v in images.items()}, torch.from_numpy(measures).to(device)


def train_network(
    points: Points,
    target: NDArray[np.int64],
    *,
    n_classes: int,
    parameters: JointNetParameters,
    member: int = 0,
    checkpoints: Checkpoints | None = None,
    progress: bool = False,
) -> tuple[JointNet, list[dict[str, float]]]:
    """Train one network, and return it in evaluation mode with its history.

    The history has per epoch ``loss`` and, with held-out objects, ``validation_loss``.
    """
    run = _Run(points, target, n_classes, parameters, member)
    name = f"network_{member}"
    if checkpoints is not None and (state := checkpoints.load(name)) is not None:
        run.restore(state, checkpoints.locate(name))
    p = parameters.training
    epochs = range(len(run.history), p.epochs)
    for epoch in tqdm(epochs, desc=f"network {member + 1} of {p.n_members}", unit="epoch", disable=not progress):
        if run.since_best >= p.patience and run.best is not None:
            break
        run.pass_once(epoch)
        if checkpoints is not None and (epoch % 10 == 9 or epoch == p.epochs - 1):
            checkpoints.save(name, run.state())
    return run.result()


class _Run:
    """State of one training, as saved in a checkpoint."""

    def __init__(
        self, points: Points, target: NDArray[np.int64], n_classes: int, parameters: JointNetParameters, member: int
    ) -> None:
        self.parameters, self.member = parameters, member
        p = parameters.training
        self.device = find_device(p.device)
        held = _held_out(target, p)
        self.train, self.held = _take(points, np.flatnonzero(~held)), _take(points, np.flatnonzero(held))
        self.target = torch.from_numpy(target[~held]).to(self.device)
        self.held_target = torch.from_numpy(target[held]).to(self.device)
        with reproducible(self._seed(0)):
            self.network = JointNet(parameters, n_classes)
        self._scale_measures()
        self.network.to(self.device)
        self.optimizer = torch.optim.SGD(
            self.network.parameters(), lr=p.learning_rate, momentum=p.momentum, weight_decay=p.weight_decay
        )
        # with the softmax that equation 11 omits
        self.loss = nn.CrossEntropyLoss(label_smoothing=p.label_smoothing, reduction=p.loss)
        self.history: list[dict[str, float]] = []
        self.best: dict[str, Tensor] | None = None
        self.since_best = 0

    def _scale_measures(self) -> None:
        """Standardise the measures (mean 0, deviation 1); the flag of known intensity becomes -1 or 1."""
        measures = torch.from_numpy(encode(self.train, self.parameters.inputs)[1])
        if measures.shape[1]:
            self.network.shift.copy_(measures.mean(dim=0))
            self.network.scale.copy_(measures.std(dim=0, correction=0).clamp(min=0.05))
            self.network.shift[-1], self.network.scale[-1] = 0.5, 0.5

    def _seed(self, epoch: int) -> int:
        return int(np.random.SeedSequence([self.parameters.training.seed, self.member, epoch]).generate_state(1)[0])

    def pass_once(self, epoch: int) -> None:
        """Run one epoch; random numbers depend on the seed, the network and the epoch only."""
        p = self.parameters.training
        rng = np.random.default_rng(self._seed(epoch + 1))
        losses, counts = [], []
        with reproducible(self._seed(epoch + 1)):
            self.network.train()
            for copy in range(p.copies):
                augmented = augment(self.train, p.augmentation, rng)
                images, measures = to_tensors(*encode(augmented, self.parameters.inputs), self.device)
                order = torch.from_numpy(rng.permutation(len(self.target))).to(self.device)
                batches = [rows for rows in order.split(p.batch_size) if len(rows) > 1]
                for i, rows in enumerate(batches):
                    step = (epoch * p.copies + copy) * len(batches) + i
                    self._set_rate(scheduled_rate(step, p.epochs * p.copies * len(batches), epoch, p))
                    losses.append(self._step({view: v[rows] for view, v in images.items()}, measures[rows], rows))
                    counts.append(len(rows))
        self.history.append({"loss": float(np.dot(losses, counts)) / max(sum(counts), 1)})
        if not np.isfinite(self.history[-1]["loss"]):
            raise DataError(
                f"training of jointnet diverged in epoch {epoch + 1}: lower training.learning_rate "
                f"({p.learning_rate:g}), set training.clip, or training.loss to mean"
            )
        if len(self.held_target):
            self._validate()

    def _set_rate(self, rate: float) -> None:
        for group in self.optimizer.param_groups:
            group["lr"] = rate

    def _step(self, images: dict[str, Tensor], measures: Tensor, rows: Tensor) -> float:
        """Take one gradient step on a batch and return its loss."""
        self.optimizer.zero_grad()
        mixed = self.parameters.training.mixed_precision and self.device.type == "cuda"
        with torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=mixed):
            scores = self.network(images, measures)
        loss = torch.stack([self.loss(head.float(), self.target[rows]) for head in scores]).sum()
        loss.backward()
        if self.parameters.training.clip:
            nn.utils.clip_grad_norm_(self.network.parameters(), self.parameters.training.clip)
        self.optimizer.step()
        return float(loss.detach()) / (len(rows) if self.parameters.training.loss == "sum" else 1)

    def _validate(self) -> None:
        self.network.eval()
        with reproducible(0), torch.no_grad():
            scores = self.network(*to_tensors(*encode(self.held, self.parameters.inputs), self.device))
            log_probability = torch.log(torch.softmax(scores, dim=2).mean(dim=0).clamp(min=1e-12))
            loss = float(nn.functional.nll_loss(log_probability, self.held_target))
        self.history[-1]["validation_loss"] = loss
        before = [entry["validation_loss"] for entry in self.history[:-1]]
        self.since_best += 1
        if not before or loss < min(before):
            self.best = {name: value.detach().clone() for name, value in self.network.state_dict().items()}
            self.since_best = 0

    def _identity(self) -> str:
        return repr((asdict(self.parameters), self.member, len(self.train.xyz), self.target.tolist()))

    def state(self) -> dict[str, Any]:
        """Return the state as tensors and plain values."""
        return {
            "identity": self._identity(),
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "history": self.history,
            "best": self.best,
            "since_best": self.since_best,
        }

    def restore(self, state: dict[str, Any], source: str) -> None:
        """Resume from a saved state; `source` names it in messages."""
        if state.get("identity") != self._identity():
            raise ReadError(f"{source} is a checkpoint of another training; remove it, or train with the same objects")
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.history, self.best, self.since_best = state["history"], state["best"], state["since_best"]
        logger.info("%s: training resumes after epoch %d", source, len(self.history))

    def _settle(self) -> None:
        """Estimate means and variances of batch normalisation over whole epochs; running ones cover few batches.

        Wu and Johnson 2021, "Rethinking 'Batch' in BatchNorm", section 3.
        """
        norms = [module for module in self.network.modules() if isinstance(module, nn.BatchNorm2d)]
        if not norms:
            return
        for norm in norms:
            norm.reset_running_stats()
            norm.momentum = None  # plain mean over all batches
        p = self.parameters.training
        rng = np.random.default_rng(self._seed(p.epochs + 1))
        self.network.train()
        with reproducible(self._seed(p.epochs + 1)), torch.no_grad():
            for _ in range(SETTLE):
                augmented = augment(self.train, p.augmentation, rng)
                images, measures = to_tensors(*encode(augmented, self.parameters.inputs), self.device)
                for rows in torch.from_numpy(rng.permutation(len(self.target))).to(self.device).split(_SETTLE_BATCH):
                    self.network({view: v[rows] for view, v in images.items()}, measures[rows])

    def result(self) -> tuple[JointNet, list[dict[str, float]]]:
        """Return the network of the best epoch or, without held-out objects, of the last."""
        if self.best is not None:
            self.network.load_state_dict(self.best)
        self._settle()
        return self.network.eval(), self.history


def _held_out(target: NDArray[np.int64], p: TrainingParameters) -> NDArray[np.bool_]:
    """Select the held-out objects: the same share of every class that has at least two objects."""
    held = np.zeros(len(target), dtype=np.bool_)
    rng = np.random.default_rng(p.seed)
    for label in np.unique(target):
        rows = rng.permutation(np.flatnonzero(target == label))
        held[rows[: min(round(p.validation * len(rows)), len(rows) - 1)]] = True
    return held


def _take(points: Points, rows: NDArray[np.int64]) -> Points:
    chosen = np.isin(points.owner, rows)
    indptr = np.append(0, np.cumsum(np.diff(points.indptr)[rows])).astype(np.int64)
    return Points(points.xyz[chosen], indptr, points.intensity[chosen], points.known[rows])
