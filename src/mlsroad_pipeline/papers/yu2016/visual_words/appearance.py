"""Appearance of objects: bags of words, sizes and profiles, and their similarity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.papers.yu2016.visual_words.profiles import profile_similarity


def count_words(
    words: NDArray[np.integer], objects: NDArray[np.integer], *, n_objects: int, stopped: NDArray[np.bool_]
) -> csr_array:
    """Count the words of each object."""
    if len(words) != len(objects):
        raise DataError(f"{len(words)} words for the objects of {len(objects)} groups")
    keep = ~stopped[words]
    counts = csr_array((np.ones(int(keep.sum())), (objects[keep], words[keep])), shape=(n_objects, len(stopped)))
    counts.sum_duplicates()
    return counts


def inverse_document_frequency(counts: csr_array) -> NDArray[np.float64]:
    """Return log(N / N_i) of each word over the objects of a database (second factor of equation 22)."""
    occurs = np.bincount(counts.indices[counts.data > 0], minlength=counts.shape[1])
    return np.where(occurs > 0, np.log(counts.shape[0] / np.maximum(occurs, 1)), 0.0)


def weigh_words(counts: csr_array, inverse_frequency: NDArray[np.float64]) -> csr_array:
    """Return the bags: term frequency times inverse document frequency (equations 21 and 22)."""
    lengths = np.diff(counts.indptr)
    totals = np.repeat(np.asarray(counts.sum(axis=1)).ravel(), lengths)
    return csr_array(
        (counts.data / totals * inverse_frequency[counts.indices], counts.indices, counts.indptr), shape=counts.shape
    )


def similarity(queries: csr_array, bags: csr_array) -> NDArray[np.float64]:
    """Return the normalised histogram intersection of every query with every bag (equation 23)."""
    if queries.shape[1] != bags.shape[1]:
        raise DataError(f"bags of {queries.shape[1]} and {bags.shape[1]} words cannot be compared")
    return np.asarray(
        _intersections(
            queries.data, queries.indices, queries.indptr, bags.data, bags.indices, bags.indptr, queries.shape[1]
        )
    )


@njit(cache=True, nogil=True)
def _intersections(
    data: NDArray[np.float64], indices: NDArray, indptr: NDArray,
    others: NDArray[np.float64], other_indices: NDArray, other_indptr: NDArray, n_words: int,
) -> NDArray[np.float64]:  # fmt: skip
    """Return equation 23 for sparse bags."""
    n_queries, n_bags = len(indptr) - 1, len(other_indptr) - 1
    out = np.zeros((n_queries, n_bags))
    dense = np.zeros(n_words)
    for q in range(n_queries):
        mass = 0.0
        for k in range(indptr[q], indptr[q + 1]):
            dense[indices[k]] = data[k]
            mass += data[k]
        for b in range(n_bags):
            least, other = 0.0, 0.0
            for k in range(other_indptr[b], other_indptr[b + 1]):
                least += min(dense[other_indices[k]], others[k])
                other += others[k]
            most = mass + other - least  # sum of the maxima
            out[q, b] = least / most if most > 0.0 else 0.0
        for k in range(indptr[q], indptr[q + 1]):
            dense[indices[k]] = 0.0
    return out


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


@dataclass(frozen=True)
class Appearance:
    """Bags of words, sizes and profiles of objects."""

    bags: csr_array  # Bags, see `weigh_words`
    sizes: NDArray[np.float32]  # Sizes, see `measure_sizes`
    profiles: NDArray[np.float32]  # Profiles, see `measure_profiles`

    def __len__(self) -> int:
        """Return the number of objects."""
        return len(self.sizes)

    def select(self, rows: NDArray) -> Appearance:
        """Return some of the objects."""
        return Appearance(self.bags[rows], self.sizes[rows], self.profiles[rows])


def appearance_of(bags: csr_array, sizes: ArrayLike | None, profiles: ArrayLike | None) -> Appearance:
    """Return the appearance of objects."""
    n = bags.shape[0]
    large = np.ones((n, len(SIZES)), np.float32) if sizes is None else np.asarray(sizes, dtype=np.float32)
    if large.shape != (n, len(SIZES)):
        raise DataError(f"{n} objects need sizes of shape ({n}, {len(SIZES)}), got {large.shape}")
    spread = np.ones((n, 1), np.float32) if profiles is None else np.asarray(profiles, dtype=np.float32)
    if spread.ndim != 2 or len(spread) != n:
        raise DataError(f"{n} objects need one profile each, got an array of shape {spread.shape}")
    return Appearance(bags, large, spread)


def appearance_similarity(
    queries: Appearance, objects: Appearance, *, size_share: float, profile_share: float
) -> NDArray[np.float64]:
    """Return the similarity of objects to queries."""
    share = 1.0 - size_share - profile_share
    alike = similarity(queries.bags, objects.bags)
    if share < 1:
        alike = share * alike
        if size_share > 0:
            alike += size_share * size_similarity(queries.sizes, objects.sizes)
        if profile_share > 0:
            alike += profile_share * profile_similarity(queries.profiles, objects.profiles)
    return alike
