"""Class probabilities of any number of labellers made into calibrated ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.special import log_softmax, softmax

from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError


@dataclass(frozen=True)
class PoolParameters:
    """How the weights of a `LogLinearPool` are learned.

    Parameters
    ----------
    penalty : float, default 1e-3
        Weight of the squared distance of the weights from plain multiplication of the probabilities (Bayes' rule for
        independent labellers). Larger trusts the labellers as they are; smaller trusts few points of test set 1.
    balance : float, default 0.5
        Power of the inverse class frequency by which points weigh: 0 aims at overall accuracy, 1 at the mean recall of
        the classes.
    floor : float, default 1e-3
        Least probability: a labeller that is sure may still be wrong.
    n_points : int, default 100000
        Points of test set 1 that are used at most, evenly spaced; more take longer and change little.

    Raises
    ------
    ParameterError
        If a value is outside its domain.
    """

    penalty: float = 1e-3
    balance: float = 0.5
    floor: float = 1e-3
    n_points: int = 100_000

    def __post_init__(self) -> None:
        if not np.isfinite(self.penalty) or self.penalty < 0:
            raise ParameterError(f"penalty must be a finite number >= 0, got {self.penalty!r}")
        if not 0 <= self.balance <= 1:
            raise ParameterError(f"balance must be in [0, 1], got {self.balance!r}")
        if not 0 < self.floor < 0.5:
            raise ParameterError(f"floor must be in (0, 0.5), got {self.floor!r}")
        if isinstance(self.n_points, bool) or self.n_points != int(self.n_points) or self.n_points < 1:
            raise ParameterError(f"n_points must be an integer >= 1, got {self.n_points!r}")


@dataclass(frozen=True)
class LogLinearPool:
    """A log-linear pool with a matrix of weights per labeller.

    The log odds of the classes are a bias and, summed over the labellers that see the point, ``W_k log p_k + b_k``.
    With W_k the identity and b_k minus the log prior it is Bayes' rule for independent labellers; W_k learns how far
    each is to be trusted for each class, and which classes it confuses. A temperature per class is its diagonal.

    Parameters
    ----------
    bias : ndarray of shape (classes,), float64
        Log odds where no labeller sees the point.
    weights : ndarray of shape (labellers, classes, classes), float64
        W_k; row: class that gains, column: class that the labeller speaks of.
    offsets : ndarray of shape (labellers, classes), float64
        b_k.
    floor : float
        Least probability that is taken from a labeller.

    References
    ----------
    .. [1] C. Genest, J. Zidek, "Combining probability distributions: a critique and an annotated bibliography",
       Statistical Science 1(1), 1986, section 3.
    .. [2] C. Guo et al., "On calibration of modern neural networks", ICML, 2017, section 4.2 (matrix scaling).
    """

    bias: NDArray[np.float64]
    weights: NDArray[np.float64]
    offsets: NDArray[np.float64]
    floor: float

    @classmethod
    def fit(
        cls, probabilities: Sequence[ArrayLike], reference: ArrayLike, *, parameters: PoolParameters | None = None
    ) -> LogLinearPool:
        """Learn the weights on test set 1.

        Parameters
        ----------
        probabilities : sequence of array-like, each of shape (n, classes)
            Class probabilities of each labeller; rows of NaN where it does not see the point.
        reference : array-like of int, shape (n,)
            True labels; points labelled -1 are ignored.
        parameters : PoolParameters, optional
            How; the defaults where none are given.

        Returns
        -------
        LogLinearPool
            The pool. The same input gives the same weights.

        Raises
        ------
        DataError
            If there is no labeller, shapes differ, a row is NaN in part, or no point is labelled.
        """
        how = PoolParameters() if parameters is None else parameters
        truth = np.asarray(reference)
        tables = _checked(probabilities, None if not len(probabilities) else (len(truth), _width(probabilities[0])))
        known = np.flatnonzero(truth >= 0)
        if not len(known):
            raise DataError("fusion needs labelled points to learn from")
        known = known[:: int(np.ceil(len(known) / how.n_points))]
        n_classes = tables.shape[2]
        if int(truth[known].max()) >= n_classes:
            raise DataError(f"labels must be below {n_classes}, got {int(truth[known].max())}")
        features, seen = _features(tables[:, known], how.floor)
        count = np.bincount(truth[known], minlength=n_classes)
        weight = np.divide(1.0, count, out=np.zeros(n_classes), where=count > 0) ** how.balance * (count > 0)
        share = weight[truth[known]] / weight[truth[known]].sum()
        prior = _log_prior(count, how.floor)
        found = _fit(features, seen, truth[known], share, prior, how.penalty)
        return cls(*found, floor=how.floor)

    def predict_proba(self, probabilities: Sequence[ArrayLike]) -> NDArray[np.float64]:
        """Pool the probabilities of all labellers.

        Parameters
        ----------
        probabilities : sequence of array-like, each of shape (n, classes)
            Class probabilities of each labeller, in the order of training; rows of NaN where it does not see the point.

        Returns
        -------
        ndarray of shape (n, classes), float64
            Probabilities that sum to 1; where no labeller sees the point, those of the classes on test set 1.

        Raises
        ------
        DataError
            If the number of labellers or classes differs, or a row is NaN in part.
        """
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
    for k, given in enumerate(probabilities):
        array = np.asarray(given)
        if array.shape != shape:
            raise DataError(f"probabilities of labeller {k} must have shape {shape}, got {array.shape}")
        gaps = np.isnan(array)
        partly = np.flatnonzero(gaps.any(axis=1) & ~gaps.all(axis=1))
        if len(partly):
            raise DataError(
                f"probabilities of labeller {k}: row {partly[0]} is NaN in part: {array[partly[0]].tolist()}"
            )
    return np.stack([np.asarray(given, dtype=np.float64) for given in probabilities])


def _features(tables: NDArray[np.float64], floor: float) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return log probabilities (0 where unseen) and which labellers see which points."""
    seen = ~np.isnan(tables[:, :, 0])
    return np.where(seen[:, :, None], np.log(np.maximum(np.nan_to_num(tables), floor)), 0.0), seen


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


def _fit(
    features: NDArray[np.float64], seen: NDArray[np.bool_], truth: NDArray[np.integer], share: NDArray[np.float64],
    prior: NDArray[np.float64], penalty: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:  # fmt: skip
    """Minimise the weighted cross entropy plus the penalty; the problem is convex."""
    k, _, c = features.shape
    target = np.zeros((len(truth), c))
    target[np.arange(len(truth)), truth] = 1.0
    start = np.concatenate([prior, np.tile(np.eye(c), (k, 1, 1)).ravel(), np.tile(-prior, k)])

    def parts(theta: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        return theta[:c], theta[c : c + k * c * c].reshape(k, c, c), theta[c + k * c * c :].reshape(k, c)

    def loss(theta: NDArray) -> tuple[float, NDArray]:
        log_p = log_softmax(_logits(features, seen, *parts(theta)), axis=1)
        away = theta - start
        value = -float((share * log_p[np.arange(len(truth)), truth]).sum()) + 0.5 * penalty * float(away @ away)
        slope = (np.exp(log_p) - target) * share[:, None]
        gradient = [slope.sum(axis=0), *((slope.T @ table).ravel() for table in features)]
        gradient += [(slope * mask[:, None]).sum(axis=0) for mask in seen]
        return value, np.concatenate(gradient) + penalty * away

    return parts(minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 300, "gtol": 1e-6}).x)
