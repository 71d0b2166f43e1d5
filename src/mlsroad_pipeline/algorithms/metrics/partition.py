"""Quality of a partition into segments: boundary recall, under-segmentation error, accuracy ceiling."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column

IGNORED = -1


@dataclass(frozen=True)
class PartitionQuality:
    """Scores of a partition against reference labels; undefined values are NaN."""

    n_segments: int  # Segments with at least one scored point
    # Share of near pairs of points with different reference labels that lie in different segments. NaN without such
    # pairs.
    boundary_recall: float
    under_segmentation_error: float  # Share of points by which segments cross the borders of the reference; 0 is best
    # Earlier, stricter form of the error: points outside each reference label in the segments that overlap it, as a
    # share of the points. Can exceed 1; 0 is best.
    leakage: float
    # Overall accuracy if every segment has its most frequent reference label: the upper bound for any labeller of
    # segments
    accuracy_ceiling: float


def evaluate_partition(labels: ArrayLike, truth: ArrayLike, *, pairs: ArrayLike) -> PartitionQuality:
    """Return the scores of a partition against reference labels; `pairs` are points near each other, (m, 2)."""
    segments, reference = _checked(labels, truth)
    scored = np.flatnonzero(reference != IGNORED)
    segment, overlap, size, best = _overlaps(segments[scored], reference[scored])
    n = len(scored)
    if n == 0:
        return PartitionQuality(0, np.nan, np.nan, np.nan, np.nan)
    outside = size[segment] - overlap
    return PartitionQuality(
        n_segments=len(size),
        boundary_recall=_recall(segments, reference, _checked_pairs(pairs, len(segments))),
        under_segmentation_error=float(np.minimum(overlap, outside).sum() / n),
        leakage=float(outside.sum() / n),
        accuracy_ceiling=float(best.sum() / n),
    )


def _checked(labels: ArrayLike, truth: ArrayLike) -> tuple[NDArray, NDArray]:
    """Return two integer columns of the same length."""
    segments = np.asarray(labels)
    segments = check_column(segments, segments.size, "labels")
    reference = check_column(truth, len(segments), "truth")
    for name, values in (("labels", segments), ("truth", reference)):
        if len(values) and not np.issubdtype(values.dtype, np.integer):
            raise DataError(f"{name} must be integers, got {values.dtype}")
    return segments, reference.astype(np.int64)


def _overlaps(segments: NDArray, reference: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Return segment and size of every overlap with a label, and size and largest overlap of every segment."""
    _, segment = np.unique(segments, return_inverse=True)
    values, classes = np.unique(reference, return_inverse=True)
    keys, overlap = np.unique(segment.astype(np.int64) * len(values) + classes, return_counts=True)
    of_segment = keys // max(len(values), 1)
    size = np.bincount(segment)
    best = np.zeros(len(size), np.int64)
    np.maximum.at(best, of_segment, overlap)
    return of_segment, overlap, size, best


def _checked_pairs(pairs: ArrayLike, n: int) -> NDArray[np.int64]:
    near = np.asarray(pairs)
    if near.ndim != 2 or near.shape[1] != 2 or not np.issubdtype(near.dtype, np.integer):
        raise DataError(f"pairs must be integers of shape (m, 2), got {near.dtype} {near.shape}")
    if near.size and (near.min() < 0 or near.max() >= n):
        raise DataError(f"pairs must lie in 0..{n - 1}, got {near.min()} to {near.max()}")
    return near


def _recall(segments: NDArray, reference: NDArray, near: NDArray[np.int64]) -> float:
    """Return the share of near pairs across a reference border that lie in different segments."""
    i, j = near[:, 0], near[:, 1]
    border = (reference[i] != reference[j]) & (reference[i] != IGNORED) & (reference[j] != IGNORED)
    return float((segments[i[border]] != segments[j[border]]).mean()) if border.any() else float("nan")
