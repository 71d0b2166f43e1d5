"""Starts of the search for an offset: height from the ground of common cells, plan from votes of pairs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.registration.surfaces import Surfaces

GROUND_CELL = 1.0
"""Edge length of the cells whose lowest flat patch counts as ground, metres."""

FEWEST_CELLS = 9
"""Fewest cells with ground of both recordings."""

STEP, BIN = 0.1, 0.05
"""Step of the votes in plan, and width of the bins of distances along a normal, metres."""

N_DIRECTIONS, LIKE = 36, 0.98
"""Number of directions of upright patches, and least cosine between the normals of a pair."""

N_STARTS, APART = 4, 0.35
"""Number of places in plan that the search starts from, and their least distance, metres."""

MOST_PATCHES = 3000
"""Largest number of upright patches that vote."""

POLE_VOTE = 4.0
"""Votes of a pair of pieces of poles; a pair of patches has one."""

SEAM = 3.0
"""Largest distance between the grounds of recordings that border on each other, metres."""


def coarse_height(fixed: Surfaces, moving: Surfaces, largest: float) -> float | None:
    """Return the commonest difference in height of the ground in common cells, or None without enough of them."""
    (a, low_a), (b, low_b) = (_ground(surfaces) for surfaces in (fixed, moving))
    _, in_a, in_b = np.intersect1d(a, b, return_indices=True)
    gaps = low_a[in_a, 2] - low_b[in_b, 2]
    gaps = gaps[np.abs(gaps) <= largest]
    return None if len(gaps) < FEWEST_CELLS else _commonest(gaps)


def seam_height(fixed: Surfaces, moving: Surfaces, largest: float) -> tuple[float, float, int] | None:
    """Return the step of the ground between recordings that border on each other, its error and number of places."""
    low_a, low_b = (_ground(surfaces)[1] for surfaces in (fixed, moving))
    if not len(low_a) or not len(low_b):
        return None
    distance, near = cKDTree(low_a[:, :2]).query(low_b[:, :2], distance_upper_bound=SEAM)
    found = np.isfinite(distance)
    gaps = low_a[near[found], 2] - low_b[found, 2]
    gaps = gaps[np.abs(gaps) <= largest]
    if len(gaps) < FEWEST_CELLS:
        return None
    height = _commonest(gaps)
    around = np.abs(gaps - height)
    return height, float(max(0.1, 1.4826 * np.median(around[around < 1.0]))), len(gaps)


def _ground(surfaces: Surfaces) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Return the cells in plan with a flat patch, as complex numbers, and the lowest one of each."""
    level = surfaces.centre[surfaces.level]
    level = level[np.argsort(level[:, 2], kind="stable")]
    index = np.floor(level[:, :2] / GROUND_CELL)
    cells, first = np.unique(index[:, 0] + 1j * index[:, 1], return_index=True)
    return cells, level[first]


def _commonest(values: NDArray[np.float64], width: float = 0.2) -> float:
    """Return the middle of the interval of some width that holds most values."""
    ordered = np.sort(values)
    counts = np.searchsorted(ordered, ordered + width, side="right") - np.arange(len(ordered))
    best = int(counts.argmax())
    return float(np.median(ordered[best : best + counts[best]]))


def coarse_plans(fixed: Surfaces, moving: Surfaces, largest: float) -> NDArray[np.float64]:
    """Return shifts in plan to start from, the best first; zero alone where nothing votes."""
    half = int(np.ceil(largest / STEP))
    axis = np.arange(-half, half + 1) * STEP
    plan = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    votes = gaussian_filter(_pole_votes(fixed, moving, half), 1.0) + _patch_votes(fixed, moving, largest, plan)
    votes[np.hypot(plan[..., 0], plan[..., 1]) > largest] = 0.0
    found: list[NDArray[np.float64]] = []
    while len(found) < N_STARTS and votes.max() > 0:
        found.append(plan[np.unravel_index(int(votes.argmax()), votes.shape)])
        votes[np.hypot(*(plan - found[-1]).transpose(2, 0, 1)) < APART] = 0.0
    return np.array(found) if found else np.zeros((1, 2))


def _pole_votes(fixed: Surfaces, moving: Surfaces, half: int) -> NDArray[np.float64]:
    votes = np.zeros((2 * half + 1, 2 * half + 1))
    if not len(fixed.pole) or not len(moving.pole):
        return votes
    scale = np.array([1.0, 1.0, half * STEP / 0.3])  # pieces at like heights
    trees = [cKDTree(poles * scale) for poles in (moving.pole, fixed.pole)]
    pairs = trees[0].sparse_distance_matrix(trees[1], 1.5 * half * STEP, output_type="coo_matrix")
    gap = np.rint((fixed.pole[pairs.col] - moving.pole[pairs.row])[:, :2] / STEP).astype(np.int64) + half
    inside = ((gap >= 0) & (gap <= 2 * half)).all(axis=1)
    np.add.at(votes, tuple(gap[inside].T), 2 * np.pi * POLE_VOTE)  # the filter spreads a vote over 2 pi cells
    return votes


def _patch_votes(fixed: Surfaces, moving: Surfaces, largest: float, plan: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the votes of pairs of upright patches of one direction: each for all shifts along its plane."""
    votes = np.zeros(plan.shape[:2])
    (theirs, normal), (mine, other) = _directed(fixed), _directed(moving)
    if not len(theirs) or not len(mine):
        return votes
    pairs = cKDTree(mine).sparse_distance_matrix(cKDTree(theirs), largest + 0.5, output_type="coo_matrix")
    row, col = pairs.row.astype(np.int64), pairs.col
    like = np.abs(np.einsum("ij,ij->i", other[row], normal[col])) > LIKE
    row, col = row[like], col[like]
    n_bins = 2 * int(np.ceil(1.5 * largest / BIN)) + 1
    place = np.rint(np.einsum("ij,ij->i", normal[col], theirs[col] - mine[row]) / BIN).astype(np.int64) + n_bins // 2
    direction = np.clip(np.arctan2(normal[:, 1], normal[:, 0]) / np.pi * N_DIRECTIONS, 0, N_DIRECTIONS - 1).astype(int)
    for number in range(N_DIRECTIONS):
        own = (direction[col] == number) & (place >= 0) & (place < n_bins)
        if not own.any():
            continue
        once = np.unique(row[own] * n_bins + place[own]) % n_bins
        histogram = gaussian_filter(np.bincount(once, minlength=n_bins).astype(np.float64), 1.5)
        across = normal[direction == number].mean(axis=0)[:2]
        at = np.rint((plan @ (across / np.linalg.norm(across))) / BIN).astype(np.int64) + n_bins // 2
        votes += histogram[np.clip(at, 0, n_bins - 1)]
    return votes


def _directed(surfaces: Surfaces) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return upright patches with normals towards the upper half plane."""
    rows = np.flatnonzero(surfaces.upright)
    rows = rows[:: max(1, -(-len(rows) // MOST_PATCHES))]
    normal = surfaces.normal[rows]
    sign = np.where((normal[:, 1] < 0) | ((normal[:, 1] == 0) & (normal[:, 0] < 0)), -1.0, 1.0)
    return surfaces.centre[rows], normal * sign[:, None]
