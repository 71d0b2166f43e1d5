"""Segments of a survey that a user labels in active learning: connected voxels of one predicted class, cut into cells.

The order of the questions joins uncertainty (the margin of the two best classes), size, and diversity: the distance in
features to segments that were asked before, as in the core set (Sener and Savarese 2018).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

CELL, GAP, LEAST = 4.0, 0.4, 10
"""Edge of the cells that cut segments, distance that a segment bridges, metres, and fewest voxels of a segment."""

_FLOOR, _NEAR, _SIZE = 0.05, 0.5, 0.5
_OFFSETS = [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) > (0, 0, 0)]


class Segments(NamedTuple):
    """Segments of the voxels of a survey."""

    owner: NDArray[np.int64]  # Segment of each voxel
    size: NDArray[np.int64]  # Number of voxels
    probabilities: NDArray[np.float64]  # Mean probabilities of the groups of classes
    features: NDArray[np.float32]  # Mean standardised features


def find_segments(xyz: ArrayLike, values: NDArray[np.float32], probabilities: NDArray[np.float64]) -> Segments:
    """Return the segments of voxels."""
    points = np.asarray(xyz, np.float64)
    if not len(points):
        return Segments(np.zeros(0, np.int64), np.zeros(0, np.int64), probabilities[:0], values[:0])
    cells = np.floor((points - points.min(axis=0)) / GAP).astype(np.int64)
    label = probabilities.argmax(axis=1)
    _, ny, nz = (int(n) + 3 for n in cells.max(axis=0))
    shape = (int(cells[:, 0].max()) + 3, ny, nz)
    keys = ((label * shape[0] + cells[:, 0] + 1) * ny + cells[:, 1] + 1) * nz + cells[:, 2] + 1
    occupied, first, of_voxel = np.unique(keys, return_index=True, return_inverse=True)
    block = (cells[first] * GAP // CELL).astype(np.int64)
    pairs = []
    for i, j, k in _OFFSETS:
        wanted = occupied + (i * ny + j) * nz + k
        place = np.minimum(np.searchsorted(occupied, wanted), len(occupied) - 1)
        joined = (occupied[place] == wanted) & (block[place] == block).all(axis=1)
        pairs.append(np.stack([np.flatnonzero(joined), place[joined]]))
    start, end = np.concatenate(pairs, axis=1)
    edges = coo_array((np.ones(len(start), np.int8), (start, end)), shape=(len(occupied),) * 2)
    _, component = connected_components(edges, directed=False)
    owner = component.astype(np.int64)[of_voxel]
    size = np.bincount(owner)
    return Segments(owner, size, _means(owner, size, probabilities), _means(owner, size, _standardised(values)))


def order_of_questions(
    segments: Segments, number: int, *, asked: ArrayLike = (), seed: int | None = None, least: int = LEAST
) -> NDArray[np.int64]:
    """Return the segments to label next, in order."""
    best = np.sort(segments.probabilities, axis=1)
    margin = best[:, -1] - best[:, -2] if best.shape[1] > 1 else np.zeros(len(best))
    worth = np.where(segments.size >= least, (_FLOOR + 1.0 - margin) * segments.size**_SIZE, 0.0)
    if seed is not None:
        worth = worth * np.exp(0.1 * np.random.default_rng(seed).standard_normal(len(worth)))
    novelty = np.ones(len(worth))
    scale = _NEAR * np.sqrt(segments.features.shape[1])
    for known in np.asarray(asked, np.int64).tolist():
        novelty = np.minimum(novelty, _distance(segments.features, known, scale))
        worth[known] = 0.0
    order: list[int] = []
    for _ in range(min(number, int((worth > 0).sum()))):
        row = int(np.argmax(np.where(worth > 0, worth * novelty, -1.0)))
        order.append(row)
        worth[row] = 0.0
        novelty = np.minimum(novelty, _distance(segments.features, row, scale))
    return np.array(order, np.int64)


def _distance(features: NDArray[np.float32], row: int, scale: float) -> NDArray[np.float64]:
    apart = np.sqrt(((features - features[row]) ** 2).sum(axis=1, dtype=np.float64))
    return apart / (apart + scale)


def _means(owner: NDArray[np.int64], size: NDArray[np.int64], values: NDArray) -> NDArray:
    order = np.argsort(owner, kind="stable")
    starts = np.cumsum(size) - size
    return (np.add.reduceat(values[order], starts, axis=0) / size[:, None]).astype(values.dtype)


def _standardised(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return features in standard deviations from their median, within -3 to 3; 0 where they are missing."""
    sample = values[:: max(len(values) // 20000, 1)]
    known = ~np.isnan(sample)
    filled = np.where(known, sample, 0.0)
    present = known.any(axis=0)
    middle = np.zeros(values.shape[1])
    middle[present] = np.nanmedian(sample[:, present], axis=0)
    spread = np.sqrt((known * (filled - middle) ** 2).sum(axis=0) / np.maximum(known.sum(axis=0), 1)) + 1e-6
    return np.clip(np.nan_to_num((values - middle) / spread), -3, 3).astype(np.float32)
