"""PointNet, a baseline of Luo et al. 2019: features of single points, and their maximum (Qi et al. 2017)."""

from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor, nn

from mlsroad_pipeline.algorithms.core.validation import check_xyz
from mlsroad_pipeline.algorithms.models.machines.torch_training import (
    find_device,
    learning_rate,
    load_weights,
    reproducible,
)
from mlsroad_pipeline.papers.luo2019.pointnet.parameters import SLUG, PointNetParameters
from mlsroad_pipeline.papers.shared.recognition.descriptor_machine import ShapeRecogniser

_BATCH = 128
"""Objects per batch in prediction."""


def _shared(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv1d(inputs, outputs, 1), nn.BatchNorm1d(outputs), nn.ReLU())


def _dense(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, outputs), nn.BatchNorm1d(outputs), nn.ReLU())


class TransformNet(nn.Module):
    """Network that predicts a transform of the features of points into a common pose; it starts as the identity."""

    def __init__(self, n: int, parameters: PointNetParameters) -> None:
        super().__init__()
        a, b, c = parameters.widths
        self.n = n
        self.points = nn.Sequential(_shared(n, a), _shared(a, b), _shared(b, c))
        self.whole = nn.Sequential(_dense(c, parameters.hidden[0]), _dense(*parameters.hidden))
        self.matrix = nn.Linear(parameters.hidden[1], n * n)
        nn.init.zeros_(self.matrix.weight)
        with torch.no_grad():
            self.matrix.bias.copy_(torch.eye(n).flatten())

    def forward(self, points: Tensor) -> Tensor:
        """Return the transform of each object."""
        matrix: Tensor = self.matrix(self.whole(self.points(points).amax(dim=2)))
        return matrix.reshape(-1, self.n, self.n)


class PointNet(nn.Module):
    """Classification network with input and feature transforms (Qi et al. 2017, Figure 2)."""

    def __init__(self, parameters: PointNetParameters, n_classes: int) -> None:
        super().__init__()
        a, b, c = parameters.widths
        self.input_transform = TransformNet(3, parameters)
        self.first = nn.Sequential(_shared(3, 64), _shared(64, 64))
        self.feature_transform = TransformNet(64, parameters)
        self.second = nn.Sequential(_shared(64, a), _shared(a, b), _shared(b, c))
        self.whole = nn.Sequential(_dense(c, parameters.hidden[0]), _dense(*parameters.hidden))
        self.scores = nn.Sequential(nn.Dropout(parameters.dropout), nn.Linear(parameters.hidden[1], n_classes))

    def forward(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return the scores of objects."""
        posed = self.input_transform(points).transpose(1, 2) @ points
        features = self.first(posed)
        matrix: Tensor = self.feature_transform(features)
        whole = self.second(matrix.transpose(1, 2) @ features).amax(dim=2)
        scores: Tensor = self.scores(self.whole(whole))
        return scores, matrix


class PointNetRecogniser(ShapeRecogniser):
    """PointNet as an estimator."""

    slug = SLUG

    def __init__(self, parameters: PointNetParameters | None = None) -> None:
        super().__init__(parameters if parameters is not None else PointNetParameters())

    def _learn(self, objects: Sequence[ArrayLike], target: NDArray[np.int64]) -> None:
        p = self.parameters
        scaled, device = _scaled(objects), find_device(p.device)
        classes = torch.from_numpy(target).to(device)
        with reproducible(p.seed):
            self.network_ = PointNet(p, len(self.classes_)).to(device)
            optimizer = torch.optim.Adam(self.network_.parameters())
            n_steps = p.epochs * -(-len(target) // p.batch_size)
            step = 0
            for epoch in range(p.epochs):
                rng = np.random.default_rng([p.seed, epoch])
                points = torch.from_numpy(_changed(_drawn(scaled, p.n_points, rng), p.jitter, rng)).to(device)
                self.network_.train()
                for rows in torch.from_numpy(rng.permutation(len(target))).split(p.batch_size):
                    if len(rows) > 1:
                        rate = learning_rate(step, n_steps, p.learning_rate)
                        self._step(optimizer, rate, points[rows.to(device)], classes[rows.to(device)])
                    step += 1
        self.network_.eval()

    def _step(self, optimizer: torch.optim.Optimizer, rate: float, points: Tensor, target: Tensor) -> None:
        for group in optimizer.param_groups:
            group["lr"] = rate
        optimizer.zero_grad()
        scores, matrix = self.network_(points)
        away = torch.eye(matrix.shape[1], device=matrix.device) - matrix @ matrix.transpose(1, 2)
        loss = nn.functional.cross_entropy(scores, target)
        loss = loss + self.parameters.regularisation * (away**2).sum(dim=(1, 2)).mean()
        loss.backward()
        optimizer.step()

    def _probabilities(self, objects: Sequence[ArrayLike]) -> NDArray[np.float64]:
        total = np.zeros((len(objects), len(self.classes_)))
        p, scaled = self.parameters, _scaled(objects)
        device = next(self.network_.parameters()).device
        with reproducible(0), torch.inference_mode():
            for turn in range(p.n_turns):
                drawn = _drawn(scaled, p.n_points, np.random.default_rng([p.seed, turn]))
                points = torch.from_numpy(_turned(drawn, np.full(len(drawn), 2 * np.pi * turn / p.n_turns)))
                for start in range(0, len(total), _BATCH):
                    scores = self.network_(points[start : start + _BATCH].to(device))[0]
                    total[start : start + _BATCH] += torch.softmax(scores, dim=1).cpu().numpy()
        return total / p.n_turns

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the classes and the weights as plain arrays."""
        weights = {f"weights/{name}": value.cpu().numpy() for name, value in self.network_.state_dict().items()}
        return {"classes": self.classes_, **weights}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], parameters: PointNetParameters) -> Self:
        """Rebuild a recogniser from the arrays of `to_arrays`."""
        self = cls._restored(arrays, parameters)
        self.network_ = PointNet(parameters, len(self.classes_))
        load_weights(self.network_, arrays, "weights/", f"{SLUG} with {len(self.classes_)} classes")
        self.network_.to(find_device(parameters.device)).eval()
        return self


def _scaled(objects: Sequence[ArrayLike]) -> list[NDArray[np.float64]]:
    """Return the objects scaled into the ball of radius 1 about the centroid."""
    scaled = []
    for i, xyz in enumerate(objects):
        points = check_xyz(xyz, minimum=1, name=f"object {i}").astype(np.float64)
        points = points - points.mean(axis=0)
        scaled.append(points / max(float(np.linalg.norm(points, axis=1).max()), 1e-9))
    return scaled


def _drawn(objects: Sequence[NDArray[np.float64]], n: int, rng: np.random.Generator) -> NDArray[np.float32]:
    rows = [rng.permutation(len(p))[:n] if len(p) >= n else rng.integers(len(p), size=n) for p in objects]
    return np.stack([p[r].T for p, r in zip(objects, rows, strict=True)]).astype(np.float32)


def _turned(points: NDArray[np.float32], angle: NDArray[np.float64]) -> NDArray[np.float32]:
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    return np.stack([x * cos - y * sin, x * sin + y * cos, z], axis=1).astype(np.float32)


def _changed(points: NDArray[np.float32], jitter: float, rng: np.random.Generator) -> NDArray[np.float32]:
    turned = _turned(points, rng.uniform(0, 2 * np.pi, len(points)))
    return (turned + np.clip(rng.normal(size=points.shape) * jitter, -5 * jitter, 5 * jitter)).astype(np.float32)
