"""Two-stage fusion network, and kernel logistic regression on the measures of objects.

Importing this module imports PyTorch.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from sklearn.kernel_approximation import Nystroem
from sklearn.linear_model import LogisticRegression
from torch import Tensor, nn

from mlsroad_pipeline.algorithms.core.validation import check_arrays
from mlsroad_pipeline.algorithms.features.accumulation_images import N_PARTS
from mlsroad_pipeline.papers.luo2019.jointnet.inputs import Points, augment, encode
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import N_MEASURES, JointNetParameters, NetworkParameters


def _convolution(inputs: int, outputs: int, kernel: int, batch_norm: bool) -> list[nn.Module]:
    layers: list[nn.Module] = [nn.Conv2d(inputs, outputs, kernel, padding=kernel // 2, bias=not batch_norm)]
    return [*layers, *([nn.BatchNorm2d(outputs)] if batch_norm else []), nn.ReLU()]


class Halving(nn.Module):
    """Max pooling over 2 x 2 cells; the last row or column of an odd size is pooled alone."""

    def forward(self, maps: Tensor) -> Tensor:
        """Pool feature maps."""
        if self.training or maps.shape[2] % 2 or maps.shape[3] % 2:
            return nn.functional.max_pool2d(maps, 2, ceil_mode=True)
        rows = torch.maximum(maps[:, :, ::2], maps[:, :, 1::2])  # same values in a third of the time on a CPU
        return torch.maximum(rows[..., ::2], rows[..., 1::2])


class PyramidPooling(nn.Module):
    """Spatial pyramid pooling: maximum of each channel in the upper half, the lower half and the whole image.

    Two levels of 2 x 1 and 1 x 1 cells (Luo et al. 2019, Figure 5): 3 values per channel for images of any size.
    """

    def forward(self, maps: Tensor) -> Tensor:
        """Pool feature maps."""
        halves = nn.functional.adaptive_max_pool2d(maps, (2, 1)).flatten(1)
        return torch.cat([halves, maps.amax(dim=(2, 3))], dim=1)


class JointNet(nn.Module):
    """Network that scores the classes of objects from their images.

    The convolutional module f is shared by all images, as in equation 2; each view has its own two fusion modules,
    whose scores are summed (equation 10).
    """

    shift: Tensor
    scale: Tensor

    def __init__(self, parameters: JointNetParameters, n_classes: int) -> None:
        super().__init__()
        inputs, layers = parameters.inputs, parameters.network
        self.views = tuple(inputs.views)
        n_measures = N_MEASURES if inputs.measures else 0
        self.convolutional = _convolutional_module(layers, 2 if inputs.intensity else 1)
        first, second = (_first_fusion, CNN3) if layers.fusion else (_no_fusion, FullyConnected)
        self.fusion_1 = nn.ModuleDict({view: first(layers) for view in self.views})
        self.fusion_2 = nn.ModuleDict({view: second(layers, n_measures, n_classes) for view in self.views})
        self.by_measures = _measures_head(layers, n_measures, n_classes) if n_measures else None
        self.register_buffer("shift", torch.zeros(n_measures))
        self.register_buffer("scale", torch.ones(n_measures))
        self._start(n_classes, layers.initialisation)

    def _start(self, n_classes: int, initialisation: str) -> None:
        """Initialise the weights after He et al. 2015, or after Glorot and Bengio 2010 as TensorFlow does."""
        for module in self.modules():
            if isinstance(module, nn.Conv2d | nn.Linear):
                last = isinstance(module, nn.Linear) and module.out_features == n_classes
                if initialisation == "glorot":
                    nn.init.xavier_uniform_(module.weight)
                else:
                    nn.init.kaiming_normal_(module.weight, nonlinearity="linear" if last else "relu")
                if module.bias is not None:
                    nn.init.zeros_(module.bias)

    def forward(self, images: Mapping[str, Tensor], measures: Tensor) -> Tensor:
        """Return the scores of objects."""
        known = (measures - self.shift) / self.scale
        scores = []
        for view in self.views:
            maps = self.convolutional(images[view].flatten(0, 1))
            joined = maps.reshape(len(measures), -1, *maps.shape[2:])
            scores.append(self.fusion_2[view](self.fusion_1[view](joined), known))
        heads = [torch.stack(scores).sum(dim=0)]
        if self.by_measures is not None:
            heads.append(self.by_measures(known))
        return torch.stack(heads)


def _convolutional_module(p: NetworkParameters, n_channels: int) -> nn.Sequential:
    widths = (n_channels, *p.convolutional_widths)
    layers: list[nn.Module] = []
    for i, (inputs, outputs) in enumerate(pairwise(widths)):
        layers += _convolution(inputs, outputs, 5 if i == 0 else 3, p.batch_norm)
        if i in (0, 2):
            layers.append(Halving())
    return nn.Sequential(
        *layers,
        PyramidPooling(),
        nn.Linear(3 * widths[-1], p.n_hidden),
        nn.ReLU(),
        nn.Linear(p.n_hidden, p.map_channels * p.map_size**2),
        nn.ReLU(),
        nn.Unflatten(1, (p.map_channels, p.map_size, p.map_size)),
    )


def _first_fusion(p: NetworkParameters) -> nn.Sequential:
    first, second = p.fusion_widths
    return nn.Sequential(
        *_convolution(N_PARTS * p.map_channels, first, 3, p.batch_norm),
        *_convolution(first, second, 3, p.batch_norm),
    )


def _no_fusion(p: NetworkParameters) -> nn.Sequential:
    return nn.Sequential(nn.Flatten(), nn.Dropout(p.dropout))


def _measures_head(p: NetworkParameters, n_measures: int, n_classes: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(n_measures, p.n_hidden),
        nn.ReLU(),
        nn.Dropout(p.dropout),
        nn.Linear(p.n_hidden, p.n_hidden),
        nn.ReLU(),
        nn.Dropout(p.dropout),
        nn.Linear(p.n_hidden, n_classes),
    )


class CNN3(nn.Module):
    """Second fusion module of one view: four convolutions and two fully connected layers."""

    def __init__(self, p: NetworkParameters, n_measures: int, n_classes: int) -> None:
        super().__init__()
        widths = (p.fusion_widths[-1], *p.cnn3_widths)
        layers: list[nn.Module] = []
        for i, (inputs, outputs) in enumerate(pairwise(widths)):
            if i in (0, 2):
                layers.append(Halving())
            layers += _convolution(inputs, outputs, 3, p.batch_norm)
        side = -(-p.map_size // 4)
        self.convolutions = nn.Sequential(*layers, nn.Flatten())
        self.hidden = nn.Linear(widths[-1] * side**2 + n_measures, p.n_hidden)
        self.dropout = nn.Dropout(p.dropout)
        self.scores = nn.Linear(p.n_hidden, n_classes)

    def forward(self, maps: Tensor, measures: Tensor) -> Tensor:
        """Return the scores of one view."""
        values = self.dropout(torch.cat([self.convolutions(maps), measures], dim=1))
        scores: Tensor = self.scores(self.dropout(torch.relu(self.hidden(values))))
        return scores


class FullyConnected(nn.Module):
    """Fully connected layer on the values of all images of a view, in place of reshape layer and fusion modules."""

    def __init__(self, p: NetworkParameters, n_measures: int, n_classes: int) -> None:
        super().__init__()
        self.scores = nn.Linear(N_PARTS * p.map_channels * p.map_size**2 + n_measures, n_classes)

    def forward(self, values: Tensor, measures: Tensor) -> Tensor:
        """Return the scores of one view."""
        scores: Tensor = self.scores(torch.cat([values, measures], dim=1))
        return scores


COST, GAMMA = 30.0, 0.01
"""Inverse of the penalty, and gamma of the Gaussian kernel for measures of standard deviation 1."""

OUTLIERS, COPY_WEIGHT = 0.2, 0.5
"""Largest share of outliers in copies of the training objects, and weight of a copy."""

LANDMARKS, MOST_SAMPLES = 400, 20_000
"""Training samples that span the kernel (Nystroem's approximation), and the largest number of samples."""


@dataclass(frozen=True)
class MeasureRegression:
    """Trained kernel logistic regression, as flat arrays."""

    # shift, scale: measures are standardised as (x - shift) / scale
    shift: NDArray[np.float32]
    scale: NDArray[np.float32]
    landmarks: NDArray[np.float32]  # Standardised measures that span the kernel
    mixing: NDArray[np.float32]  # Inverse square root of the kernel of the landmarks
    coefficients: NDArray[np.float32]  # Weights of the classes
    intercepts: NDArray[np.float32]  # Their intercepts

    def predict_proba(self, measures: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the probability of each class."""
        x = ((measures - self.shift) / self.scale).astype(np.float64)
        square = (
            (x**2).sum(axis=1)[:, None]
            + (self.landmarks**2).sum(axis=1)
            - 2 * np.einsum("od,md->om", x, self.landmarks)
        )
        kernel = np.exp(-GAMMA * np.maximum(square, 0))
        scores = (
            np.einsum("om,cm->oc", np.einsum("om,km->ok", kernel, self.mixing), self.coefficients) + self.intercepts
        )
        odds = np.exp(scores - scores.max(axis=1, keepdims=True))
        probabilities: NDArray[np.float64] = odds / odds.sum(axis=1, keepdims=True)
        return probabilities

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the regression as named arrays."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild a regression from the arrays of `to_arrays`."""
        names = [field.name for field in fields(cls)]
        check_arrays(arrays, names, "a kernel logistic regression")
        return cls(**{name: np.asarray(arrays[name]) for name in names})


def train_regression(
    points: Points, target: NDArray[np.int64], parameters: JointNetParameters
) -> MeasureRegression | None:
    """Train the regression on objects and on augmented copies."""
    p = parameters.training
    if not parameters.inputs.measures or not p.regression_share:
        return None
    rng, n = np.random.default_rng(p.seed), len(target)
    copies = min(p.regression_copies, max(MOST_SAMPLES // n - 1, 0))
    changes = replace(p.augmentation, hide_intensity=0.0, outliers=max(p.augmentation.outliers, OUTLIERS))
    sets = [points, *(augment(points, changes, rng) for _ in range(copies))]
    features = np.concatenate([encode(one, parameters.inputs)[1] for one in sets])
    shift, spread = features.mean(axis=0), features.std(axis=0)
    scale = np.where(spread > 0, spread, 1).astype(np.float32)
    scaled = (features - shift) / scale
    kernel = Nystroem(gamma=GAMMA, n_components=min(LANDMARKS, len(scaled)), random_state=p.seed).fit(scaled)
    weights = np.repeat([1.0, COPY_WEIGHT], [n, copies * n])
    model = LogisticRegression(C=COST, max_iter=500).fit(kernel.transform(scaled), np.tile(target, len(sets)), weights)
    coefficients, intercepts = model.coef_, model.intercept_
    if len(coefficients) == 1:  # scikit-learn's form for two classes
        coefficients, intercepts = np.concatenate([0 * coefficients, coefficients]), np.append(0.0, intercepts)
    learned = (shift, scale, kernel.components_, kernel.normalization_, coefficients, intercepts)
    return MeasureRegression(*(np.asarray(part, dtype=np.float32) for part in learned))
