"""Log-linear pool: calibrated class probabilities from those of several labellers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.special import log_softmax, softmax

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError


@dataclass(frozen=True)
class PoolParameters:
    """Parameters of the fit of a `LogLinearPool`."""

    # Strengths of the L2 penalty towards the initial weights; one of several is selected by cross-validation over
    # contiguous parts of test set 1. Larger stays closer to the initial weights; smaller overfits small samples.
    penalties: tuple[float, ...] = (1e-2,)
    # Initial weights: the first labeller alone, or the product of all probabilities. The product is Bayes' rule for
    # independent labellers; labellers of the same point are not independent.
    start: Literal["first", "product"] = "first"
    # Exponent of the inverse class frequency in the weights of points: 0 optimises overall accuracy, 1 the mean recall
    # of the classes
    balance: float = 0.25
    floor: float = 1e-3  # Lower bound of the probabilities of a labeller
    # Maximum number of points of the fit, evenly spaced within each class; rare classes are used whole. Larger takes
    # longer and changes the weights little.
    n_points: int = 5_000
    n_folds: int = 5  # Number of contiguous parts of test set 1, in the order of its points, in the cross-validation

    def __post_init__(self) -> None:
        object.__setattr__(self, "penalties", tuple(self.penalties))
        if not self.penalties or not all(np.isfinite(penalty) and penalty >= 0 for penalty in self.penalties):
            raise ParameterError(f"penalties must be finite numbers >= 0, got {self.penalties!r}")
        if self.start not in ("first", "product"):
            raise ParameterError(f"start must be 'first' or 'product', got {self.start!r}")
        if not 0 <= self.balance <= 1:
            raise ParameterError(f"balance must be in [0, 1], got {self.balance!r}")
        if not 0 < self.floor < 0.5:
            raise ParameterError(f"floor must be in (0, 0.5), got {self.floor!r}")
        for name, least in (("n_points", 1), ("n_folds", 2)):
            value = getattr(self, name)
            if isinstance(value, bool) or value != int(value) or value < least:
                raise ParameterError(f"{name} must be an integer >= {least}, got {value!r}")


@dataclass(frozen=True)
class LogLinearPool:
    """Log-linear pool with a weight matrix per labeller.

    The log odds of the classes are a bias plus the sum of ``W_k log p_k + b_k`` over the labellers that see the point.
    With the identity as W_k and the negative log prior as b_k it is Bayes' rule for independent labellers.
    """

    bias: NDArray[np.float64]  # Log odds where no labeller sees the point
    weights: NDArray[np.float64]  # W_k; rows are the pooled classes, columns those of the labeller
    offsets: NDArray[np.float64]  # b_k
    floor: float  # Lower bound of the probabilities of a labeller
    penalty: float = 0.0  # Penalty of the fit

    @classmethod
    def fit(
        cls, probabilities: Sequence[ArrayLike], reference: ArrayLike, *, parameters: PoolParameters | None = None
    ) -> LogLinearPool:
        """Fit the weights on test set 1."""
        settings = PoolParameters() if parameters is None else parameters
        truth = np.asarray(reference)
        tables = _checked(probabilities, None if not len(probabilities) else (len(truth), _width(probabilities[0])))
        known = np.flatnonzero(truth >= 0)
        if not len(known):
            raise DataError("fusion needs labelled points to learn from")
        n_classes = tables.shape[2]
        if int(truth[known].max()) >= n_classes:
            raise DataError(f"labels must be below {n_classes}, got {int(truth[known].max())}")
        count = np.bincount(truth[known], minlength=n_classes)
        prior = np.divide(1.0, count, out=np.zeros(n_classes), where=count > 0) ** settings.balance * (count > 0)
        chosen, stands_for = _sample(truth[known], settings.n_points)
        known = known[chosen]
        features, seen = _features(tables[:, known], settings.floor)
        weight = prior[truth[known]] * stands_for
        problem = _Problem(features, seen, truth[known], weight, _start(count, len(tables), settings))
        penalty = problem.chosen_penalty(settings.penalties, settings.n_folds)
        return cls(*problem.solve(penalty), floor=settings.floor, penalty=penalty)

    def predict_proba(self, probabilities: Sequence[ArrayLike]) -> NDArray[np.float64]:
        """Pool the probabilities of all labellers."""
        n = len(np.asarray(probabilities[0])) if len(probabilities) else 0
        tables = _checked(probabilities, (n, len(self.bias)))
        if len(tables) != len(self.weights):
            raise DataError(f"expected {len(self.weights)} labellers, got {len(tables)}")
        features, seen = _features(tables, self.floor)
        pooled: NDArray[np.float64] = softmax(_logits(features, seen, self.bias, self.weights, self.offsets), axis=1)
        return pooled


def _width(table: ArrayLike) -> int:
    array = np.asarray(table)
    return int(array.shape[1]) if array.ndim == 2 else 0


def _checked(probabilities: Sequence[ArrayLike], shape: tuple[int, int] | None) -> NDArray[np.float64]:
    if shape is None:
        raise DataError("fusion needs at least one labeller")
    for k, table in enumerate(probabilities):
        array = np.asarray(table)
        if array.shape != shape:
            raise DataError(f"probabilities of labeller {k} must have shape {shape}, got {array.shape}")
        gaps = np.isnan(array)
        partly = np.flatnonzero(gaps.any(axis=1) & ~gaps.all(axis=1))
        if len(partly):
            raise DataError(
                f"probabilities of labeller {k}: row {partly[0]} is NaN in part: {array[partly[0]].tolist()}"
            )
    return np.stack([np.asarray(table, dtype=np.float64) for table in probabilities])


def _features(tables: NDArray[np.float64], floor: float) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return log probabilities (0 where unseen) and which labellers see which points."""
    seen = ~np.isnan(tables[:, :, 0])
    return np.where(seen[:, :, None], np.log(np.maximum(np.nan_to_num(tables), floor)), 0.0), seen


def _sample(truth: NDArray[np.integer], n_points: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return sampled rows, evenly spaced within each class, and the number of points that each represents."""
    count = np.bincount(truth)
    left, most = n_points, 0
    for k, size in enumerate(np.sort(count[count > 0])):  # unused shares of small classes go to larger ones
        most = max(left // (int((count > 0).sum()) - k), 1)
        left -= min(int(size), most)
    step = np.ceil(count / most).astype(np.int64)
    order = np.argsort(truth, kind="stable")
    rank = np.empty(len(truth), dtype=np.int64)
    rank[order] = np.arange(len(truth)) - np.repeat(np.cumsum(count) - count, count)
    rows = np.flatnonzero(rank % np.maximum(step, 1)[truth] == 0)
    stands_for: NDArray[np.float64] = count[truth[rows]] / np.bincount(truth[rows], minlength=len(count))[truth[rows]]
    return rows, stands_for


def _log_prior(count: NDArray[np.int64], floor: float) -> NDArray[np.float64]:
    log_prior: NDArray[np.float64] = np.log(np.maximum(count / count.sum(), floor * 1e-3))
    return log_prior


def _logits(
    features: NDArray[np.float64], seen: NDArray[np.bool_], bias: NDArray[np.float64], weights: NDArray[np.float64],
    offsets: NDArray[np.float64],
) -> NDArray[np.float64]:  # fmt: skip
    out = np.tile(bias, (features.shape[1], 1))
    for k, table in enumerate(features):
        out += table @ weights[k].T + np.where(seen[k][:, None], offsets[k], 0.0)
    return out


def _start(count: NDArray[np.int64], n_labellers: int, settings: PoolParameters) -> NDArray[np.float64]:
    """Return the initial weights, towards which the penalty shrinks."""
    prior = _log_prior(count, settings.floor)
    share = np.ones(n_labellers)
    if settings.start == "first":
        share[1:] = 0.0
    weights = np.einsum("k,cd->kcd", share, np.eye(len(count)))
    return np.concatenate([prior, weights.ravel(), np.outer(share, -prior).ravel()])


@dataclass(frozen=True)
class _Problem:
    """Convex problem: weighted cross entropy plus the penalty."""

    features: NDArray[np.float64]
    seen: NDArray[np.bool_]
    truth: NDArray[np.integer]
    weight: NDArray[np.float64]
    start: NDArray[np.float64]

    def parts(self, theta: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return bias, weights and offsets."""
        k, _, c = self.features.shape
        return theta[:c], theta[c : c + k * c * c].reshape(k, c, c), theta[c + k * c * c :].reshape(k, c)

    def of(self, rows: NDArray[np.bool_]) -> _Problem:
        """Return the problem on a subset of the points."""
        return replace(
            self, features=self.features[:, rows], seen=self.seen[:, rows], truth=self.truth[rows],
            weight=self.weight[rows],
        )  # fmt: skip

    def entropy(self, theta: NDArray) -> float:
        """Return the weighted sum of the cross entropies of the points."""
        log_p = log_softmax(_logits(self.features, self.seen, *self.parts(theta)), axis=1)
        return -float(self.weight @ log_p[np.arange(len(self.truth)), self.truth])

    def chosen_penalty(self, penalties: Sequence[float], n_folds: int) -> float:
        """Return the penalty with the lowest cross-validated entropy."""
        if len(penalties) == 1:
            return float(penalties[0])
        n = len(self.truth)
        fold = np.arange(n) * min(n_folds, n) // n
        held_out = [
            sum(self.of(fold == k).entropy(self.of(fold != k).minimum(penalty)) for k in range(fold[-1] + 1))
            for penalty in penalties
        ]
        return float(penalties[int(np.argmin(held_out))])

    def solve(self, penalty: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return bias, weights and offsets at the minimum."""
        return self.parts(self.minimum(penalty))

    def minimum(self, penalty: float) -> NDArray[np.float64]:
        """Return bias, weights and offsets at the minimum as one vector."""
        n, c = len(self.truth), self.features.shape[2]
        target = np.zeros((n, c))
        target[np.arange(n), self.truth] = 1.0
        share = self.weight / max(self.weight.sum(), 1e-300)

        def loss(theta: NDArray) -> tuple[float, NDArray]:
            log_p = log_softmax(_logits(self.features, self.seen, *self.parts(theta)), axis=1)
            away = theta - self.start
            value = -float((share * log_p[np.arange(n), self.truth]).sum()) + 0.5 * penalty * float(away @ away)
            slope = (np.exp(log_p) - target) * share[:, None]
            gradient = [slope.sum(axis=0), *((slope.T @ table).ravel() for table in self.features)]
            gradient += [(slope * mask[:, None]).sum(axis=0) for mask in self.seen]
            return value, np.concatenate(gradient) + penalty * away

        options = {"maxiter": 100, "gtol": 1e-6}
        minimum: NDArray[np.float64] = minimize(loss, self.start, jac=True, method="L-BFGS-B", options=options).x
        return minimum
