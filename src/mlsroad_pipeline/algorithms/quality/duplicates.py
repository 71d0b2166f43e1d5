"""Exact duplicates of points: exact count within an array, sketch across arrays in bounded memory."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

SKETCH_SIZE = 262_144
"""Distinct points per sketch, 4 MiB. The error of an estimated count falls with the square root of this size."""


@dataclass(frozen=True)
class DuplicateSketch:
    """Counts of the distinct points with the smallest hashes (bottom-k sketch).

    The selection depends on coordinates only: a sketch has all copies of a point or none, in any chunk, and the merged
    sketch of two chunks equals the sketch of their concatenation.
    """

    hashes: NDArray[np.uint64]  # Smallest hashes, ascending, at most `SKETCH_SIZE`
    counts: NDArray[np.int64]  # Number of occurrences of each hash
    complete: bool  # Whether the sketch covers all points
    share: float = 1.0  # Share of the range of hashes that the sketch covers, from 0

    def n_duplicates(self) -> int:
        """Return the number of duplicates: exact if the sketch is complete, estimated otherwise."""
        repeats = int((self.counts - 1).sum())
        if self.complete or repeats == 0:
            return repeats
        is_full = len(self.hashes) == SKETCH_SIZE
        return round(repeats / (float(self.hashes[-1]) / 2.0**64 if is_full else self.share))


def sketch_of(hashes: NDArray[np.uint64], *, n_total: int | None = None) -> DuplicateSketch:
    """Return the sketch of one array of points."""
    # Hashes are uniform, so twice the share of a full sketch is enough unless most points are duplicates.
    if n_total is not None and n_total > 2 * SKETCH_SIZE:
        share = 2 * SKETCH_SIZE / n_total
        distinct, counts = np.unique(hashes[hashes < np.uint64(2.0**64 * share)], return_counts=True)
        return DuplicateSketch(distinct[:SKETCH_SIZE], counts[:SKETCH_SIZE].astype(np.int64), False, share)
    # Select before sorting: start with room for as many duplicates as distinct points, and enlarge if needed.
    room = 2 * SKETCH_SIZE
    while True:
        few = len(hashes) <= room
        chosen = hashes if few else np.partition(hashes, room)[: room + 1]
        if not few:
            chosen = chosen[chosen < chosen.max()]  # all copies below the cut, none at the cut
        distinct, counts = np.unique(chosen, return_counts=True)
        if few or len(distinct) >= SKETCH_SIZE:
            break
        room *= 4
    complete = few and len(distinct) <= SKETCH_SIZE
    return DuplicateSketch(distinct[:SKETCH_SIZE], counts[:SKETCH_SIZE].astype(np.int64), complete)


def merge_sketches(sketches: Sequence[DuplicateSketch]) -> DuplicateSketch:
    """Return the sketch of the concatenated chunks."""
    distinct, inverse = np.unique(np.concatenate([s.hashes for s in sketches]), return_inverse=True)
    counts = np.zeros(len(distinct), dtype=np.int64)
    np.add.at(counts, inverse, np.concatenate([s.counts for s in sketches]))
    complete = all(s.complete for s in sketches) and len(distinct) <= SKETCH_SIZE
    return DuplicateSketch(distinct[:SKETCH_SIZE], counts[:SKETCH_SIZE], complete, min(s.share for s in sketches))


@njit(cache=True)
def _mix(value: np.uint64) -> np.uint64:
    """Return the finaliser of splitmix64."""
    value ^= value >> np.uint64(30)
    value *= np.uint64(0xBF58476D1CE4E5B9)
    value ^= value >> np.uint64(27)
    value *= np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


@njit(cache=True)
def hash_points(xyz: NDArray[np.float64]) -> NDArray[np.uint64]:
    """Return a 64-bit hash of each row of (n, 3) coordinates; 0.0 and -0.0 are equal."""
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
    """Return the number of rows that equal an earlier row; hashes select the candidates, coordinates are compared."""
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
