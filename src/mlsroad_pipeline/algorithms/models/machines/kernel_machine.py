"""Trained one-against-one support vector machine with a Gaussian kernel, as flat arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from itertools import combinations, pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]  # it has no stubs

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_arrays
from mlsroad_pipeline.algorithms.models.machines.pairwise import couple_probabilities

_BLOCK = 64
"""Rows per block of kernel values, which fits the cache."""


@dataclass(frozen=True)
class Choice:
    """Hyperparameters chosen by cross-validation."""

    cost: float  # C, and gamma of the Gaussian kernel
    gamma: float  # C, and gamma of the Gaussian kernel
    mean_f1: float  # Mean F1 over the classes on held-out samples


@dataclass(frozen=True)
class KernelMachine:
    """Support vectors, coefficients, and the sigmoids that map decision values to probabilities."""

    shift: NDArray[np.float32]  # Features are standardised as (x - shift) / scale
    scale: NDArray[np.float32]  # Features are standardised as (x - shift) / scale
    vectors: NDArray[np.float32]  # Support vectors in standardised features, class by class
    n_vectors: NDArray[np.int64]  # Number of support vectors of each class
    # Dual coefficients in the layout of LIBSVM: for a vector of class i, row j - 1 holds the coefficient against class
    # j > i, and row j that against class j < i
    coefficients: NDArray[np.float32]
    intercepts: NDArray[np.float32]  # Intercepts of the pairs (0, 1), (0, 2), ..., (1, 2), ..
    gamma: float  # The kernel is exp(-gamma |x - y|^2)
    sigmoids: NDArray[np.float64]  # Platt's a and b of each pair

    @classmethod
    def from_svc(
        cls, model: Any, shift: NDArray[np.float32], scale: NDArray[np.float32], sigmoids: NDArray[np.float64]
    ) -> Self:
        """Convert a ``sklearn.svm.SVC`` with a Gaussian kernel, trained on features (x - `shift`) / `scale`."""
        # With two classes, scikit-learn flips the sign: decisions are positive for the second class.
        sign = -1.0 if len(model.classes_) == 2 else 1.0
        return cls(
            shift,
            scale,
            np.ascontiguousarray(model.support_vectors_, dtype=np.float32),
            model.n_support_.astype(np.int64),
            np.ascontiguousarray(sign * model.dual_coef_, dtype=np.float32),
            (sign * model.intercept_).astype(np.float32),
            float(model.gamma),
            sigmoids,
        )

    def decide(self, features: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the decision values (n, t (t - 1) / 2) of all pairs of classes, positive for the first class.

        `features` are not standardised; `DataError` if their number is not d.
        """
        if features.ndim != 2 or features.shape[1] != self.vectors.shape[1]:
            raise DataError(f"features must have shape (n, {self.vectors.shape[1]}), got {features.shape}")
        ends = np.concatenate([[0], np.cumsum(self.n_vectors)])
        slices = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        lengths = (self.vectors**2).sum(axis=1)
        out = np.empty((len(features), len(self.intercepts)), np.float32)
        with threadpool_limits(1):  # results independent of the number of threads
            for start in range(0, len(features), _BLOCK):
                x = (features[start : start + _BLOCK] - self.shift) / self.scale
                square = (x**2).sum(axis=1)[:, None] + lengths - 2.0 * (x @ self.vectors.T)
                kernel = np.exp(-np.float32(self.gamma) * np.maximum(square, 0.0))
                sums = [kernel[:, own] @ self.coefficients[:, own].T for own in slices]
                for k, (i, j) in enumerate(combinations(range(len(slices)), 2)):
                    out[start : start + _BLOCK, k] = sums[i][:, j - 1] + sums[j][:, i] + self.intercepts[k]
        return out

    def predict_proba(self, features: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return class probabilities (n, t) of unscaled features; `DataError` if their number is not d."""
        exponent = self.decide(features) * self.sigmoids[:, 0] + self.sigmoids[:, 1]
        pairs = 1.0 / (1.0 + np.exp(np.clip(exponent, -500.0, 500.0)))
        return couple_probabilities(pairs, len(self.n_vectors)).astype(np.float32)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the machine as named arrays."""
        return {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild a machine from the arrays of `to_arrays`; `DataError` if one is missing."""
        names = [field.name for field in fields(cls)]
        check_arrays(arrays, names, "a kernel machine")
        own: dict[str, Any] = {name: np.asarray(arrays[name]) for name in names}
        return cls(**{**own, "gamma": float(own["gamma"])})
