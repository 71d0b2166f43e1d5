"""Training and prediction of a one-against-one support vector machine with a Gaussian kernel, as flat arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import combinations, pairwise, product
from typing import Any, Self

import numpy as np
from joblib import Parallel, delayed
from numba import njit
from numpy.typing import NDArray
from sklearn.metrics import f1_score
from sklearn.svm import SVC
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]  # it has no stubs

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_arrays

_MAX_STEPS = 100
_CLIP = 1e-7
_TOLERANCE = 0.005


def fit_sigmoid(decisions: NDArray[np.floating], first: NDArray[np.bool_]) -> tuple[float, float]:
    """Fit P(first class | decision) = 1 / (1 + exp(a decision + b)) (Platt 1999; Lin et al. 2007) and return a and b.

    The fit minimises the cross entropy against Platt's targets, which lie inside (0, 1), by Newton's method with step
    halving. `decisions` are held-out decision values; `first` marks samples of the first class.
    """
    values = decisions.astype(np.float64)
    n_first, n_other = int(first.sum()), int((~first).sum())
    target = np.where(first, (n_first + 1) / (n_first + 2), 1 / (n_other + 2))
    a, b = 0.0, float(np.log((n_other + 1) / (n_first + 1)))
    loss = _cross_entropy(a * values + b, target)
    for _ in range(_MAX_STEPS):
        p = 1 / (1 + np.exp(np.clip(a * values + b, -500, 500)))
        slope, weight = target - p, p * (1 - p) + 1e-12
        gradient = np.array([(values * slope).sum(), slope.sum()])
        if np.abs(gradient).max() < 1e-5:
            break
        curvature = np.array(
            [[(values**2 * weight).sum(), (values * weight).sum()], [(values * weight).sum(), weight.sum()]]
        ) + 1e-12 * np.eye(2)
        step = np.linalg.solve(curvature, -gradient)
        length = 1.0
        while length >= 1e-10:
            trial = _cross_entropy((a + length * step[0]) * values + b + length * step[1], target)
            if trial < loss + 1e-4 * length * (gradient @ step):
                break
            length /= 2
        if length < 1e-10:
            break
        a, b, loss = a + length * step[0], b + length * step[1], trial
    return float(a), float(b)


def _cross_entropy(exponent: NDArray[np.float64], target: NDArray[np.float64]) -> float:
    # log(1 + exp(x)) without overflow
    return float((target * exponent + np.logaddexp(0.0, -exponent)).sum())


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(product: NDArray[np.float64], p: NDArray[np.float64]) -> None:
    """Write the distribution p that minimises p' Q p (Wu et al. 2004, algorithm 2)."""
    n = len(p)
    moved = np.empty(n)
    for i in range(n):
        p[i] = 1.0 / n
    for _ in range(max(100, n)):
        total, worst = 0.0, 0.0
        for i in range(n):
            moved[i] = 0.0
            for j in range(n):
                moved[i] += product[i, j] * p[j]
            total += p[i] * moved[i]
        for i in range(n):
            worst = max(worst, abs(moved[i] - total))
        if worst < _TOLERANCE / n:
            break
        for i in range(n):
            change = (total - moved[i]) / product[i, i]
            p[i] += change
            total = (total + change * (change * product[i, i] + 2.0 * moved[i])) / (1.0 + change) ** 2
            for j in range(n):
                moved[j] = (moved[j] + change * product[i, j]) / (1.0 + change)
                p[j] /= 1.0 + change


@njit(cache=True, nogil=True, error_model="numpy")
def _couple(pairs: NDArray[np.float64], n_classes: int, out: NDArray[np.float64]) -> None:
    """Solve the second problem of Wu et al. 2004 for each row of P(i | i or j), pairs in the order (0, 1), (0, 2)..."""
    share, product = np.empty((n_classes, n_classes)), np.empty((n_classes, n_classes))
    for row in range(len(pairs)):
        k = 0
        for i in range(n_classes):
            for j in range(i + 1, n_classes):
                share[i, j], share[j, i] = pairs[row, k], 1.0 - pairs[row, k]
                k += 1
        for i in range(n_classes):
            product[i, i] = 0.0
            for j in range(n_classes):
                if j != i:
                    product[i, i] += share[j, i] * share[j, i]
                    product[i, j] = -share[j, i] * share[i, j]
        _solve(product, out[row])


def couple_probabilities(pairs: NDArray[np.floating], n_classes: int) -> NDArray[np.float64]:
    """Combine the probabilities of pairs of classes into one distribution (Wu, Lin and Weng 2004, section 4).

    `pairs` holds P(i | i or j) of the pairs (0, 1), (0, 2), ..., (1, 2), ..., clipped to [1e-7, 1 - 1e-7]; the result
    is (n, n_classes), with rows of sum 1.
    """
    out = np.empty((len(pairs), n_classes))
    _couple(np.clip(np.ascontiguousarray(pairs, dtype=np.float64), _CLIP, 1 - _CLIP), n_classes, out)
    return out


_BLOCK = 64
"""Rows per block of kernel values, which fits the cache."""


@dataclass(frozen=True)
class Choice:
    """Hyperparameters chosen by cross-validation."""

    # cost, gamma: C, and gamma of the Gaussian kernel
    cost: float
    gamma: float
    mean_f1: float  # Mean F1 over the classes on held-out samples


@dataclass(frozen=True)
class KernelMachine:
    """Support vectors, coefficients, and the sigmoids that map decision values to probabilities."""

    # shift, scale: features are standardised as (x - shift) / scale
    shift: NDArray[np.float32]
    scale: NDArray[np.float32]
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


Folds = Sequence[tuple[NDArray, NDArray]]
"""Training rows and held-out rows of each fold."""


def standardise(features: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the mean of each feature, and its standard deviation with 1 for constant features."""
    spread = features.std(axis=0)
    return features.mean(axis=0), np.where(spread > 0, spread, 1).astype(np.float32)


def choose_machine(
    features: NDArray[np.float32],
    labels: NDArray[np.integer],
    folds: Folds,
    *,
    costs: Sequence[float],
    gammas: Sequence[float],
    n_threads: int = 1,
) -> Choice:
    """Return C and gamma with the best mean F1 on held-out samples; ties go to the smaller values.

    The features, float32 (n, d), are standardised. The result does not depend on the threads.
    """
    grid: list[tuple[float, float]] = list(product(sorted(costs), sorted(gammas)))
    run: Any = delayed(_score)
    scores = Parallel(n_jobs=n_threads, prefer="threads")(run(features, labels, folds, c, g) for c, g in grid)
    best = int(np.argmax(scores))
    return Choice(*grid[best], scores[best])


def fit_machine(
    features: NDArray[np.float32],
    labels: NDArray[np.integer],
    choice: Choice,
    *,
    held_out: NDArray[np.float32],
    held_out_labels: NDArray[np.integer],
    folds: Folds,
) -> KernelMachine:
    """Train a support vector machine, and sigmoids on held-out decision values.

    `features`, float32 (n, d), are not standardised; `held_out`, those of the samples of the folds, are, with the mean
    and standard deviation of `features`.
    """
    shift, scale = standardise(features)
    trained = np.unique(labels).astype(np.int64)
    decisions = _decide_held_out(held_out, held_out_labels, folds, trained, choice.cost, choice.gamma)
    model = SVC(C=choice.cost, gamma=choice.gamma, decision_function_shape="ovo", cache_size=500)
    model.fit((features - shift) / scale, labels)
    return KernelMachine.from_svc(model, shift, scale, _sigmoids(decisions, held_out_labels, trained))


def _decide_held_out(
    features: NDArray[np.float32],
    labels: NDArray[np.integer],
    folds: Folds,
    trained: NDArray[np.int64],
    cost: float,
    gamma: float,
) -> NDArray[np.float64]:
    """Return the held-out decision values of all pairs; NaN for pairs absent from the training part of a fold."""
    pairs = {pair: k for k, pair in enumerate(combinations(trained.tolist(), 2))}
    out = np.full((len(features), len(pairs)), np.nan)
    for train, test in folds:
        model = SVC(C=cost, gamma=gamma, decision_function_shape="ovo", cache_size=200)
        model.fit(features[train], labels[train])
        values = model.decision_function(features[test])
        known = model.classes_.tolist()
        if len(known) == 2:
            values = -values[:, None]  # scikit-learn's sign for two classes
        columns = np.array([pairs[pair] for pair in combinations(known, 2)])
        out[np.ix_(test, columns)] = values
    return out


def _vote(decisions: NDArray[np.float64], trained: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the class that wins most pairs, the lowest of equal ones."""
    votes = np.zeros((len(decisions), len(trained)), np.int64)
    for k, (i, j) in enumerate(combinations(range(len(trained)), 2)):
        votes[:, i] += decisions[:, k] > 0
        votes[:, j] += decisions[:, k] <= 0
    return trained[votes.argmax(axis=1)]


def _score(
    features: NDArray[np.float32],
    labels: NDArray[np.integer],
    folds: Folds,
    cost: float,
    gamma: float,
) -> float:
    trained = np.unique(labels).astype(np.int64)
    decisions = _decide_held_out(features, labels, folds, trained, cost, gamma)
    tested = np.concatenate([test for _, test in folds])
    predicted = _vote(decisions[tested], trained)
    return float(f1_score(labels[tested], predicted, average="macro", zero_division=0))


def _sigmoids(
    decisions: NDArray[np.float64], labels: NDArray[np.integer], trained: NDArray[np.int64]
) -> NDArray[np.float64]:
    pairs = list(combinations(trained.tolist(), 2))
    samples = []
    for k, (i, j) in enumerate(pairs):
        rows = np.isfinite(decisions[:, k]) & ((labels == i) | (labels == j))
        samples.append((decisions[rows, k], labels[rows] == i))
    usable = [first.any() and not first.all() for _, first in samples]
    pooled = [sample for sample, good in zip(samples, usable, strict=True) if good] or samples
    shared = fit_sigmoid(np.concatenate([s[0] for s in pooled]), np.concatenate([s[1] for s in pooled]))
    fitted = [fit_sigmoid(*sample) if good else shared for sample, good in zip(samples, usable, strict=True)]
    return np.array(fitted, dtype=np.float64)
