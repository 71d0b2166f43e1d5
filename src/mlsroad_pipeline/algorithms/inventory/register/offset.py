"""Offset of a register as a whole, such as that of another datum or of its digitising."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

SEARCHED = 5.0
"""Largest offset in each direction, metres."""
BIN = 0.25
"""Edge of the bins of displacements, metres."""
NEAR = 1.0
"""Distance from the most frequent displacement up to which pairs count, metres."""
FEWEST = 5
"""Smallest number of pairs that give an offset."""
LEAST_SHARE = 0.3
"""Smallest share of the entries that could have a pair at the offset."""


class Offset(NamedTuple):
    """Displacement from the register to the inventory in plan."""

    shift: NDArray[np.float64]  # x, y, metres; zero where it is not known
    error: NDArray[np.float64]  # Standard errors, metres; NaN where it is not known
    pairs: int  # Number of pairs that it was computed from; 0 where it is not known


def register_offset(
    entries: NDArray[np.float64],
    entry_kind: NDArray[np.str_],
    objects: NDArray[np.float64],
    object_kind: NDArray[np.str_],
) -> Offset:
    """Return the most frequent displacement from entries to objects of the same kind, refined by its pairs.

    Examples
    --------
    >>> entries = np.array([[0.0, 0], [12, 3], [25, 1], [40, 5], [52, 2], [60, 4]])
    >>> kind = np.repeat("pole", 6)
    >>> found = register_offset(entries, kind, entries + [1.5, -0.5], kind)
    >>> found.shift.round(3).tolist(), found.pairs
    ([1.5, -0.5], 6)
    """
    nothing = Offset(np.zeros(2), np.full(2, np.nan), 0)
    moves, owner = [np.zeros((0, 2))], [np.zeros(0, dtype=np.int64)]
    for kind in np.unique(entry_kind):
        own, other = np.flatnonzero(entry_kind == kind), np.flatnonzero(object_kind == kind)
        if not len(other):
            continue
        lists = cKDTree(objects[other]).query_ball_point(entries[own], SEARCHED * np.sqrt(2))
        pairs = np.repeat(own, [len(found) for found in lists])
        partner = other[np.concatenate([np.array(found, dtype=np.int64) for found in lists])]
        moves.append(objects[partner] - entries[pairs])
        owner.append(pairs)
    move, entry = np.concatenate(moves), np.concatenate(owner)
    inside = (np.abs(move) < SEARCHED).all(axis=1)
    move, entry = move[inside], entry[inside]
    if len(move) < FEWEST:
        return nothing
    shift = _most_frequent(move)
    for _ in range(10):
        near = np.hypot(*(move - shift).T) <= NEAR
        before, shift = shift, np.median(move[near], axis=0)
        if np.abs(shift - before).max() < 1e-4:
            break
    near = np.hypot(*(move - shift).T) <= NEAR
    n_pairs = len(np.unique(entry[near]))
    if n_pairs < max(FEWEST, LEAST_SHARE * len(np.unique(entry))):
        return nothing
    # The standard error of a median is 1.25 times that of a mean.
    error = 1.25 * move[near].std(axis=0) / np.sqrt(n_pairs)
    return Offset(shift, error, n_pairs)


def _most_frequent(move: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the centre of the 3 x 3 bins with most displacements; of equal ones that nearest to zero."""
    size = round(2 * SEARCHED / BIN)
    cell = np.clip(((move + SEARCHED) / BIN).astype(np.int64), 0, size - 1)
    votes = np.zeros((size + 2, size + 2))
    np.add.at(votes, (cell[:, 0] + 1, cell[:, 1] + 1), 1.0)
    summed = sum(votes[i : i + size, j : j + size] for i in range(3) for j in range(3))
    best = np.argwhere(summed == np.max(summed))
    centres = (best + 0.5) * BIN - SEARCHED
    centre: NDArray[np.float64] = centres[np.hypot(*centres.T).argmin()]
    return centre
