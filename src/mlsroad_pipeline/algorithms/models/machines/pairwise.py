"""Class probabilities from the decision values of one-against-one classifiers."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

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
