"""How well a segmentation finds the objects that are there: overlaps of segments with reference instances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.geometry.sorting import rank_integers

_FRAGMENT = 0.1  # the least share of an instance, or of a segment, that counts as a part of it


@dataclass(frozen=True)
class Overlaps:
    """Which segments share how many points with which instances.

    Attributes
    ----------
    instances, segments : ndarray of int64
        Their numbers, ascending.
    instance_sizes, segment_sizes : ndarray of int64
        Their points.
    instance, segment : ndarray of int64, shape (m,)
        Index into `instances` and `segments` of each pair that shares points.
    shared : ndarray of int64, shape (m,)
        Points of the pair.
    """

    instances: NDArray[np.int64]
    segments: NDArray[np.int64]
    instance_sizes: NDArray[np.int64]
    segment_sizes: NDArray[np.int64]
    instance: NDArray[np.int64]
    segment: NDArray[np.int64]
    shared: NDArray[np.int64]

    @property
    def iou(self) -> NDArray[np.float64]:
        """Intersection over union of each pair."""
        union = self.instance_sizes[self.instance] + self.segment_sizes[self.segment] - self.shared
        return self.shared / union


@dataclass(frozen=True)
class InstanceScores:
    """Scores of a segmentation against reference instances; NaN where there is nothing to score.

    Attributes
    ----------
    coverage : float
        Mean over instances of the best IoU that a segment has with it.
    weighted_coverage : float
        The same, weighted by the points of the instances.
    precision, recall : float
        Share of segments, and of instances, that match one to one with an IoU above the threshold.
    over_segmentation : float
        Share of instances of which two or more segments, each mostly in it, hold a tenth or more each.
    under_segmentation : float
        Share of segments of which two or more instances make up a tenth or more each.
    n_instances, n_segments : int
        How many were compared.
    """

    coverage: float
    weighted_coverage: float
    precision: float
    recall: float
    over_segmentation: float
    under_segmentation: float
    n_instances: int
    n_segments: int


def find_overlaps(instances: ArrayLike, segments: ArrayLike, *, background: int = 0) -> Overlaps:
    """Count the points that instances and segments share.

    Parameters
    ----------
    instances : array-like of shape (n,), integer
        Reference instance of each point.
    segments : array-like of shape (n,), integer
        Segment of each point; -1 is none.
    background : int, default 0
        The number of points that belong to no instance; they count to the size of segments.

    Returns
    -------
    Overlaps
        Pairs ordered by instance, then segment.

    Raises
    ------
    DataError
        If the lengths differ or the numbers are no integers.
    """
    truth, found = np.asarray(instances), np.asarray(segments)
    if truth.shape != found.shape or truth.ndim != 1:
        raise DataError(f"instances have shape {truth.shape}, segments {found.shape}: one number per point is needed")
    for name, values in (("instances", truth), ("segments", found)):
        if not np.issubdtype(values.dtype, np.integer):
            raise DataError(f"{name} must be integers, got {values.dtype}")
    real, in_segment = truth != background, found != -1
    names, own = rank_integers(truth[real])
    labels, of = rank_integers(found[in_segment])
    row, column = np.full(len(truth), -1, np.int64), np.full(len(truth), -1, np.int64)
    row[real], column[in_segment] = own, of
    both = real & in_segment
    pairs, pair = rank_integers(row[both] * max(len(labels), 1) + column[both])
    shared = np.bincount(pair, minlength=len(pairs))
    return Overlaps(
        names,
        labels,
        np.bincount(own, minlength=len(names)),
        np.bincount(of, minlength=len(labels)),
        pairs // max(len(labels), 1),
        pairs % max(len(labels), 1),
        shared,
    )


def score_segmentation(
    instances: ArrayLike, segments: ArrayLike, *, background: int = 0, iou_threshold: float = 0.5, min_points: int = 1
) -> InstanceScores:
    """Score a segmentation of points into objects.

    Parameters
    ----------
    instances : array-like of shape (n,), integer
        Reference instance of each point.
    segments : array-like of shape (n,), integer
        Segment of each point; -1 is none.
    background : int, default 0
        The number of points of no instance. Segments that lie mostly in it are not judged: what is there has no
        reference.
    iou_threshold : float, default 0.5
        A match has a larger IoU; at 0.5 and above matches are one to one by themselves.
    min_points : int, default 1
        Smaller instances are not looked for, and smaller segments not judged.

    Returns
    -------
    InstanceScores
        The scores.

    Raises
    ------
    DataError
        If the lengths differ or the numbers are no integers.
    ParameterError
        If `iou_threshold` is not in [0.5, 1).
    """
    if not 0.5 <= iou_threshold < 1:
        raise ParameterError(f"iou_threshold must be at least 0.5 and below 1, got {iou_threshold!r}")
    pairs = find_overlaps(instances, segments, background=background)
    covered = np.bincount(pairs.segment, pairs.shared, minlength=len(pairs.segments))
    judged = (2 * covered > pairs.segment_sizes) & (pairs.segment_sizes >= min_points)
    wanted = pairs.instance_sizes >= min_points
    best = np.zeros(len(pairs.instances))
    np.maximum.at(best, pairs.instance, pairs.iou)
    match = (pairs.iou > iou_threshold) & wanted[pairs.instance] & judged[pairs.segment]
    n_instances, n_segments = int(wanted.sum()), int(judged.sum())
    sizes = pairs.instance_sizes[wanted]
    split, merged = _split_and_merged(pairs)
    return InstanceScores(
        coverage=_mean(best[wanted]),
        weighted_coverage=float(best[wanted] @ sizes / sizes.sum()) if n_instances else np.nan,
        precision=float(match.sum() / n_segments) if n_segments else np.nan,
        recall=float(match.sum() / n_instances) if n_instances else np.nan,
        over_segmentation=_mean(split[wanted]),
        under_segmentation=_mean(merged[judged]),
        n_instances=n_instances,
        n_segments=n_segments,
    )


def _mean(values: NDArray) -> float:
    return float(values.mean()) if len(values) else np.nan


def _split_and_merged(pairs: Overlaps) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell which instances are split over several segments, and which segments hold several instances."""
    sizes, lengths = pairs.instance_sizes[pairs.instance], pairs.segment_sizes[pairs.segment]
    piece = (2 * pairs.shared > lengths) & (pairs.shared >= _FRAGMENT * sizes)
    part = pairs.shared >= _FRAGMENT * lengths
    return (
        np.bincount(pairs.instance[piece], minlength=len(pairs.instances)) > 1,
        np.bincount(pairs.segment[part], minlength=len(pairs.segments)) > 1,
    )
