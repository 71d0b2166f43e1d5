"""Exact duplicates of points: counted exactly in one array, and across arrays in bounded memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

SKETCH_SIZE = 262_144
"""Distinct points that a sketch remembers, 4 MiB. The error of an estimated count falls with its square root."""


@dataclass(frozen=True)
class DuplicateSketch:
    """The distinct points with the smallest hashes, and how often each occurred.

    Which points a sketch remembers depends on their coordinates alone, so all copies of a point are remembered or none,
    in whichever chunk they lie, and the merged sketch of two chunks is that of the chunks read as one.

    Attributes
    ----------
    hashes : ndarray of shape (m,), uint64
        Smallest hashes, ascending, at most `SKETCH_SIZE`.
    counts : ndarray of shape (m,), int64
        Occurrences of each.
    complete : bool
        Whether all points are remembered, and not a sample of them.
    share : float, default 1.0
        Share of all hashes that the sketch looked at, from the smallest on.
    """

    hashes: NDArray[np.uint64]
    counts: NDArray[np.int64]
    complete: bool
    share: float = 1.0

    def n_duplicates(self) -> int:
        """Return how many points repeat another: counted where the sketch is complete, else estimated from it."""
        repeats = int((self.counts - 1).sum())
        if self.complete or repeats == 0:
            return repeats
        is_full = len(self.hashes) == SKETCH_SIZE
        return round(repeats / (float(self.hashes[-1]) / 2.0**64 if is_full else self.share))


def sketch_of(hashes: NDArray[np.uint64], *, n_total: int | None = None) -> DuplicateSketch:
    """Sketch the points of one array.

    Parameters
    ----------
    hashes : ndarray of shape (n,), uint64
        Hashes of the points from `hash_points`.
    n_total : int, optional
        Points of the file that the array is a chunk of. Where it is given, the sketch leaves out hashes that will not
        be among the smallest of the file, so that the sketches of all its chunks together stay small.

    Returns
    -------
    DuplicateSketch
        The sketch.
    """
    # Hashes are spread evenly, so twice the share that a sketch remembers is enough unless most points are copies.
    if n_total is not None and n_total > 2 * SKETCH_SIZE:
        share = 2 * SKETCH_SIZE / n_total
        distinct, counts = np.unique(hashes[hashes < np.uint64(2.0**64 * share)], return_counts=True)
        return DuplicateSketch(distinct[:SKETCH_SIZE], counts[:SKETCH_SIZE].astype(np.int64), False, share)
    # Selecting before sorting: twice the size leaves room for duplicates, and more is made where that was too little.
    room = 2 * SKETCH_SIZE
    while True:
        few = len(hashes) <= room
        chosen = hashes if few else np.partition(hashes, room)[: room + 1]
        if not few:
            chosen = chosen[chosen < chosen.max()]  # all copies of what is below the cut, none of what is at it
        distinct, counts = np.unique(chosen, return_counts=True)
        if few or len(distinct) >= SKETCH_SIZE:
            break
        room *= 4
    complete = few and len(distinct) <= SKETCH_SIZE
    return DuplicateSketch(distinct[:SKETCH_SIZE], counts[:SKETCH_SIZE].astype(np.int64), complete)


def merge_sketches(sketches: Sequence[DuplicateSketch]) -> DuplicateSketch:
    """Merge the sketches of chunks into that of all their points.

    Parameters
    ----------
    sketches : sequence of DuplicateSketch
        At least one.

    Returns
    -------
    DuplicateSketch
        The sketch of the chunks read as one.
    """
    distinct, inverse = np.unique(np.concatenate([s.hashes for s in sketches]), return_inverse=True)
    counts = np.zeros(len(distinct), dtype=np.int64)
    np.add.at(counts, inverse, np.concatenate([s.counts for s in sketches]))
    complete = all(s.complete for s in sketches) and len(distinct) <= SKETCH_SIZE
    return DuplicateSketch(distinct[:SKETCH_SIZE], counts[:SKETCH_SIZE], complete, min(s.share for s in sketches))


@njit(cache=True)
def _mix(value: np.uint64) -> np.uint64:
    """Return 64 well-mixed bits of 64 bits (the finaliser of splitmix64)."""
    value ^= value >> np.uint64(30)
    value *= np.uint64(0xBF58476D1CE4E5B9)
    value ^= value >> np.uint64(27)
    value *= np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


@njit(cache=True)
def hash_points(xyz: NDArray[np.float64]) -> NDArray[np.uint64]:
    """Return a 64-bit hash of each row of (n, 3) coordinates; 0.0 and -0.0 are the same place.

    Parameters
    ----------
    xyz : ndarray of shape (n, 3), float64
        Finite coordinates.

    Returns
    -------
    ndarray of shape (n,), uint64
        Equal for equal rows.
    """
    hashes = np.empty(len(xyz), dtype=np.uint64)
    row = np.empty(3, dtype=np.float64)
    bits = row.view(np.uint64)
    for i in range(len(xyz)):
        value = np.uint64(0x9E3779B97F4A7C15)
        for axis in range(3):
            row[axis] = xyz[i, axis] + 0.0
            value = _mix(value ^ bits[axis])
        hashes[i] = value
    return hashes


@njit(cache=True)
def count_duplicates(xyz: NDArray[np.float64], hashes: NDArray[np.uint64]) -> int:
    """Return how many rows repeat an earlier one exactly; coordinates are compared, hashes only lead to them.

    Parameters
    ----------
    xyz : ndarray of shape (n, 3), float64
        Finite coordinates.
    hashes : ndarray of shape (n,), uint64
        Their hashes.

    Returns
    -------
    int
        Number of repeats.
    """
    size = 16
    while size < 2 * len(xyz):
        size *= 2
    rows = np.full(size, -1, dtype=np.int32)
    mask = np.uint64(size - 1)
    repeats = 0
    for i in range(len(xyz)):
        at = hashes[i] & mask
        while rows[at] >= 0:
            j = rows[at]
            if hashes[i] == hashes[j] and (
                xyz[i, 0] == xyz[j, 0] and xyz[i, 1] == xyz[j, 1] and xyz[i, 2] == xyz[j, 2]
            ):
                repeats += 1
                break
            at = (at + np.uint64(1)) & mask
        else:
            rows[at] = i
    return repeats
