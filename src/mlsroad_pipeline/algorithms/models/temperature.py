"""Calibration of scores by a temperature."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp

from mlsroad_pipeline.algorithms.core.exceptions import DataError

BOUNDS = (0.05, 20.0)
"""Smallest and largest temperature."""


def fit_temperature(scores: ArrayLike, truth: ArrayLike, *, weights: ArrayLike | None = None) -> float:
    """Return the temperature that calibrates scores (Guo et al. 2017, section 4.2).

    Scores are divided by it before the softmax, so the predicted classes stay the same. It minimises the negative
    logarithm of the probability of the true class over samples that the model was not trained on.

    Parameters
    ----------
    scores : array-like of float, shape (n, classes)
        Scores before the softmax.
    truth : array-like, int of shape (n,) or bool of shape (n, classes)
        True classes, or the classes that each sample may have; a negative class leaves a sample out.
    weights : array-like of float, shape (n,), optional
        Weights of the samples; equal by default.

    Returns
    -------
    float
        The temperature, within `BOUNDS`. Above 1 the scores were too confident, below 1 not confident enough.

    Raises
    ------
    DataError
        If the shapes do not fit, or no sample has a true class.

    Examples
    --------
    >>> too_confident = [[9.0, 0.0], [9.0, 0.0], [9.0, 0.0], [9.0, 0.0]]
    >>> round(fit_temperature(too_confident, [0, 0, 0, 1]), 2)  # 9 / log(3): a probability of 0.75
    8.19
    """
    values = np.asarray(scores, dtype=np.float64)
    if values.ndim != 2:
        raise DataError(f"scores must have the shape (n, classes), got {values.shape}")
    allowed = _allowed(np.asarray(truth), values.shape)
    weight = np.ones(len(values)) if weights is None else np.asarray(weights, dtype=np.float64)
    if weight.shape != (len(values),):
        raise DataError(f"{len(values)} scores need as many weights, got {weight.shape}")
    known = allowed.any(axis=1) & (weight > 0)
    if not known.any():
        raise DataError("no sample has a true class and a weight above 0: the temperature cannot be fitted")
    values, allowed, weight = values[known], allowed[known], weight[known]
    inside = np.where(allowed, values, -np.inf)

    def loss(log_temperature: float) -> float:
        factor = np.exp(-log_temperature)
        terms: NDArray[np.float64] = logsumexp(values * factor, axis=1) - logsumexp(inside * factor, axis=1)
        return float(weight @ terms)

    return float(np.exp(minimize_scalar(loss, bounds=np.log(BOUNDS), method="bounded").x))


def _allowed(truth: NDArray, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return the classes that each sample may have."""
    if truth.dtype == np.bool_ and truth.shape == shape:
        return truth
    if truth.shape != shape[:1] or truth.dtype.kind not in "iu" or (len(truth) and truth.max() >= shape[1]):
        raise DataError(f"truth must have classes below {shape[1]} for each of {shape[0]} samples, got {truth!r:.100}")
    return np.arange(shape[1]) == truth[:, None]
