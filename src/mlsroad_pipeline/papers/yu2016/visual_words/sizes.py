"""Sizes of objects, and their similarity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError

SIZES = ("bottom", "top", "length", "width")
"""Sizes of an object: heights of its ends above the ground around it, and its horizontal extents, metres."""

_SLACK = np.array([0.5, 0.5, 0.3, 0.3])  # added to compared sizes, so that differences of centimetres vanish, metres
_TAIL = 1.0  # percent of an object's points beyond each end of an extent
_CELL = 1.0  # edge of the cells of the ground grid, metres
_REACH = 1.5  # radius around an object whose cells give its ground, cells


def measure_sizes(xyz: NDArray[np.floating], objects: NDArray[np.integer]) -> NDArray[np.float32]:
    """Measure the objects of a scene."""
    n = int(objects.max(initial=-1)) + 1
    sizes = np.zeros((n, len(SIZES)), dtype=np.float32)
    rows = np.flatnonzero(objects >= 0)
    if len(rows) == 0:
        return sizes
    rows = rows[np.argsort(objects[rows], kind="stable")]
    starts = np.flatnonzero(np.diff(objects[rows], prepend=-1))
    points = xyz[rows].astype(np.float64)
    names = objects[rows[starts]]
    middle = np.add.reduceat(points[:, :2], starts) / np.diff(np.append(starts, len(rows)))[:, None]
    lowest = np.minimum.reduceat(points[:, 2], starts)
    ground = _ground_around(xyz[objects < 0].astype(np.float64), middle, lowest)
    for k, part in enumerate(np.split(points, starts[1:])):
        low, high = np.percentile(part[:, 2], [_TAIL, 100.0 - _TAIL]) - ground[k]
        off = part[:, :2] - middle[k]
        _, axes = np.linalg.eigh(off.T @ off)
        ends = np.percentile(off @ axes, [_TAIL, 100.0 - _TAIL], axis=0)
        across, along = np.sort(ends[1] - ends[0])
        sizes[names[k]] = max(low, 0.0), max(high, 0.0), along, across
    return sizes


def _ground_around(
    others: NDArray[np.float64], middle: NDArray[np.float64], lowest: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the elevation of the ground below each object, at most that of its lowest point."""
    if len(others) == 0:
        return lowest
    cell = np.floor(others[:, :2] / _CELL).astype(np.int64)
    low, span = cell.min(axis=0), int(np.ptp(cell[:, 1])) + 1
    names, owner = np.unique((cell[:, 0] - low[0]) * span + cell[:, 1] - low[1], return_inverse=True)
    floor = np.full(len(names), np.inf)
    np.minimum.at(floor, owner, others[:, 2])
    centres = (np.column_stack([names // span, names % span]) + low + 0.5) * _CELL
    near = cKDTree(centres).query_ball_point(middle, _REACH * _CELL)
    ground = np.array([np.median(floor[cells]) if cells else np.inf for cells in near])
    return np.minimum(ground, lowest)


def size_similarity(queries: NDArray[np.floating], objects: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the similarity of sizes: minimum over maximum, as equations 14 and 15 for orientations and scales."""
    if queries.shape[1:] != (len(SIZES),) or objects.shape[1:] != (len(SIZES),):
        raise DataError(f"sizes need {len(SIZES)} columns, got {queries.shape} and {objects.shape}")
    like = np.ones((len(queries), len(objects)))
    for column, slack in enumerate(_SLACK):
        one = queries[:, column].astype(np.float64)[:, None] + slack
        other = objects[:, column].astype(np.float64)[None] + slack
        like *= np.minimum(one, other) / np.maximum(one, other)
    return np.sqrt(like)


def within_sizes(sizes: NDArray[np.floating], examples: NDArray[np.floating], margin: float) -> NDArray[np.bool_]:
    """Return which objects have a size in the range of the examples of a class."""
    if len(examples) == 0:
        return np.zeros(len(sizes), np.bool_)
    own, known = sizes + _SLACK, examples + _SLACK
    inside = (own >= known.min(axis=0) / margin) & (own <= known.max(axis=0) * margin)
    return np.asarray(inside.all(axis=1))


def size_range(sizes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return minimum and maximum of each size, as examples for `within_sizes`."""
    return np.stack([sizes.min(axis=0), sizes.max(axis=0)]) if len(sizes) else sizes


def within_any_sizes(
    sizes: NDArray[np.floating], examples: Sequence[NDArray[np.floating]], margin: float
) -> NDArray[np.bool_]:
    """Return which objects have a size in the range of the examples of any class."""
    if margin == 0:
        return np.ones(len(sizes), np.bool_)
    return np.asarray(np.any([within_sizes(sizes, known, margin) for known in examples], axis=0))
