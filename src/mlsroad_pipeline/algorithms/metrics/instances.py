"""Scores of a segmentation into objects: overlaps of segments with reference instances."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.geometry.sorting import rank_integers

_FRAGMENT = 0.1  # minimum share of an instance or segment for a relevant part


@dataclass(frozen=True)
class Overlaps:
    """Numbers of points shared by segments and instances."""

    # instances, segments: numbers of the instances and segments, ascending
    instances: NDArray[np.int64]
    segments: NDArray[np.int64]
    # instance_sizes, segment_sizes: numbers of points of the instances and segments
    instance_sizes: NDArray[np.int64]
    segment_sizes: NDArray[np.int64]
    # instance, segment: index into `instances` and `segments` of each pair that shares points
    instance: NDArray[np.int64]
    segment: NDArray[np.int64]
    shared: NDArray[np.int64]  # Number of points shared by the pair

    @property
    def iou(self) -> NDArray[np.float64]:
        """Intersection over union of each pair."""
        union = self.instance_sizes[self.instance] + self.segment_sizes[self.segment] - self.shared
        return self.shared / union


@dataclass(frozen=True)
class InstanceScores:
    """Scores of a segmentation against reference instances; undefined values are NaN."""

    coverage: float  # Mean over instances of the best IoU with a segment
    weighted_coverage: float  # Coverage weighted by the points of the instances
    # precision, recall: share of segments and of instances that match one to one with an IoU above the threshold
    precision: float
    recall: float
    # Share of instances split over at least two segments that lie mostly in it and contain at least a tenth of it
    over_segmentation: float
    under_segmentation: float  # Share of segments with at least two instances that make up at least a tenth of it each
    # n_instances, n_segments: numbers of scored instances and segments
    n_instances: int
    n_segments: int


def find_overlaps(instances: ArrayLike, segments: ArrayLike, *, background: int = 0) -> Overlaps:
    """Count the points that instances and segments share."""
    truth, predicted = np.asarray(instances), np.asarray(segments)
    if truth.shape != predicted.shape or truth.ndim != 1:
        raise DataError(
            f"instances have shape {truth.shape}, segments {predicted.shape}: one number per point is needed"
        )
    for name, values in (("instances", truth), ("segments", predicted)):
        if not np.issubdtype(values.dtype, np.integer):
            raise DataError(f"{name} must be integers, got {values.dtype}")
    real, in_segment = truth != background, predicted != -1
    names, own = rank_integers(truth[real])
    labels, of = rank_integers(predicted[in_segment])
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
    """Return the scores of a segmentation of points into objects."""
    if not 0.5 <= iou_threshold < 1:
        raise ParameterError(f"iou_threshold must be at least 0.5 and below 1, got {iou_threshold!r}")
    pairs = find_overlaps(instances, segments, background=background)
    covered = np.bincount(pairs.segment, pairs.shared, minlength=len(pairs.segments))
    scored = (2 * covered > pairs.segment_sizes) & (pairs.segment_sizes >= min_points)
    relevant = pairs.instance_sizes >= min_points
    best = np.zeros(len(pairs.instances))
    np.maximum.at(best, pairs.instance, pairs.iou)
    match = (pairs.iou > iou_threshold) & relevant[pairs.instance] & scored[pairs.segment]
    n_instances, n_segments = int(relevant.sum()), int(scored.sum())
    sizes = pairs.instance_sizes[relevant]
    split, merged = _split_and_merged(pairs)
    return InstanceScores(
        coverage=_mean(best[relevant]),
        weighted_coverage=float(best[relevant] @ sizes / sizes.sum()) if n_instances else np.nan,
        precision=float(match.sum() / n_segments) if n_segments else np.nan,
        recall=float(match.sum() / n_instances) if n_instances else np.nan,
        over_segmentation=_mean(split[relevant]),
        under_segmentation=_mean(merged[scored]),
        n_instances=n_instances,
        n_segments=n_segments,
    )


def _mean(values: NDArray) -> float:
    return float(values.mean()) if len(values) else np.nan


def _split_and_merged(pairs: Overlaps) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the instances split over several segments and the segments that contain several instances."""
    sizes, lengths = pairs.instance_sizes[pairs.instance], pairs.segment_sizes[pairs.segment]
    piece = (2 * pairs.shared > lengths) & (pairs.shared >= _FRAGMENT * sizes)
    part = pairs.shared >= _FRAGMENT * lengths
    return (
        np.bincount(pairs.instance[piece], minlength=len(pairs.instances)) > 1,
        np.bincount(pairs.segment[part], minlength=len(pairs.segments)) > 1,
    )
