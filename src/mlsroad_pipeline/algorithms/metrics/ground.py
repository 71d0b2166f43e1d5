"""Scores of ground filters as in the ISPRS filter test (Sithole and Vosselman 2004)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError


@dataclass(frozen=True)
class GroundScores:
    """Errors of a ground filter as fractions; undefined values are NaN."""

    type_1: float  # Share of the true ground points that are classified as objects
    type_2: float  # Share of the true object points that are classified as ground
    total: float  # Share of all points that are misclassified
    kappa: float  # Cohen's kappa: agreement beyond chance; NaN if truth and prediction consist of the same single class
    # n_ground, n_object: numbers of scored points by true class
    n_ground: int
    n_object: int


def count_ground(is_ground: ArrayLike, reference: ArrayLike, *, valid: ArrayLike | None = None) -> NDArray[np.int64]:
    """Count points by true and predicted ground; counts of several scenes are added."""
    predicted, truth = np.asarray(is_ground), np.asarray(reference)
    scored = np.ones(truth.shape, dtype=np.bool_) if valid is None else np.asarray(valid)
    for name, array in (("is_ground", predicted), ("reference", truth), ("valid", scored)):
        if array.dtype != np.bool_ and array.size:
            raise DataError(f"{name} must be boolean, got {array.dtype}")
        if array.ndim != 1 or array.shape != truth.shape:
            raise DataError(f"{name} must have shape {truth.shape}, got {array.shape}")
    predicted, truth = predicted[scored.astype(np.bool_)], truth[scored.astype(np.bool_)]
    both = np.count_nonzero(predicted & truth)
    return np.array([both, np.count_nonzero(truth), np.count_nonzero(predicted), len(truth)], dtype=np.int64)


def scores_of_counts(counts: NDArray[np.int64]) -> GroundScores:
    """Return the scores of a ground filter from the counts of `count_ground`."""
    both, n_ground, n_predicted, n_points = (int(count) for count in counts)
    n_object = n_points - n_ground
    wrong = n_ground + n_predicted - 2 * both
    by_chance = _ratio(n_ground * n_predicted + n_object * (n_points - n_predicted), n_points**2)
    return GroundScores(
        type_1=_ratio(n_ground - both, n_ground),
        type_2=_ratio(n_predicted - both, n_object),
        total=_ratio(wrong, n_points),
        kappa=_ratio(1.0 - _ratio(wrong, n_points) - by_chance, 1.0 - by_chance),
        n_ground=n_ground,
        n_object=n_object,
    )


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole > 0 else float("nan")
