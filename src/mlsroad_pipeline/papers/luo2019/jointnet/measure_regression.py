"""Kernel logistic regression on the measures of objects; its probabilities are averaged with those of the networks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from sklearn.kernel_approximation import Nystroem
from sklearn.linear_model import LogisticRegression

from mlsroad_pipeline.algorithms.core.validation import check_arrays
from mlsroad_pipeline.papers.luo2019.jointnet.inputs import Points, augment, encode
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import JointNetParameters

COST, GAMMA = 30.0, 0.01
"""Inverse of the penalty, and gamma of the Gaussian kernel for measures of standard deviation 1."""

OUTLIERS, COPY_WEIGHT = 0.2, 0.5
"""Largest share of outliers in copies of the training objects, and weight of a copy."""

LANDMARKS, MOST_SAMPLES = 400, 20_000
"""Training samples that span the kernel (Nystroem's approximation), and the largest number of samples."""


@dataclass(frozen=True)
class MeasureRegression:
    """Trained kernel logistic regression, as flat arrays."""

    shift: NDArray[np.float32]  # Measures are standardised as (x - shift) / scale
    scale: NDArray[np.float32]  # Measures are standardised as (x - shift) / scale
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
