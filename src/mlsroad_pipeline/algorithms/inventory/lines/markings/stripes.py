"""Bright stripes of the road: a stripe between two darker bands, fitted around each bright cell."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.cells import build_cell_grids, gather_cells
from mlsroad_pipeline.algorithms.inventory.lines.markings.brightness import (
    BRIGHTNESS,
    CELL,
    CORE,
    DEVIATION,
    LEVEL,
    X,
    Y,
    Z,
)

REACH = 1.5
"""Half length of a stripe, metres, and edge of the coarse grid."""

WIDTHS = (0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6)
"""Widths of stripes, metres."""

LEAST_CLEARNESS = 4.0
"""Stripes of a smaller difference to the bands, in standard errors, are left out."""

_ALIKE = 0.5  # share of the own brightness down to which others show the direction
_TURNS = 24  # directions of half a circle
_TRIED = 2  # of them tried in full, with their neighbours: those along most cells as bright
_BIN = 0.05  # of the profile across the stripe, metres
_HALF = 16  # bins on either side of the cell
_FLANK, _GAP = 4, 1  # bins of a dark band, and between it and the stripe
_SPLIT = 4  # bins from which a stripe is compared by halves, and can be the peak of a smooth profile
_LEAST = 3  # cells in the stripe and in either band
_NEAR = 0.08  # cells this near to the axis count for its direction, metres
_OWN = 0.2  # metres along the stripe that show whether the cell itself is painted
_OWN_LEAST = 0.4  # share of the contrast of the stripe
_LEVEL = 0.04  # largest difference in height between the bands: faces of kerbs are bright, too, metres
_CORE_SHARE = 0.5  # of the points of a cell of the scene
_OFF = 0.15  # largest distance of the middle of a stripe from its cell, metres
_MOST = (3 * round(REACH / CELL) + 2) ** 2
_T, _COS, _SIN, _OFFSET, _WIDTH, _CONTRAST, _OWN_SHARE = range(7)  # columns of the fits


class Stripes(NamedTuple):
    """Bright stripes, one for each cell on a marking."""

    xyz: NDArray[np.float64]  # Place on the middle line, metres
    along: NDArray[np.float64]  # Unit vectors in plan along the stripe, of either sign
    width: NDArray[np.float64]  # One of `WIDTHS`, metres
    clearness: NDArray[np.float64]  # Difference between the stripe and the brighter band, in standard errors
    contrast: NDArray[np.float64]  # The same in standard deviations of the road


def find_stripes(cells: NDArray[np.float64], *, least_contrast: float) -> Stripes:
    """Return the bright stripes of the core of a scene."""
    plan = cells[:, :3].copy()
    plan[:, 2] = 0.0
    (blocks,) = build_cell_grids(plan, cell_size=REACH, margin=2)
    fits = _fit(cells, blocks.order, blocks.keys, blocks.starts, blocks.shape[0], np.array(WIDTHS), least_contrast)
    kept = (fits[:, _T] >= LEAST_CLEARNESS) & (np.abs(fits[:, _OFFSET]) < _OFF) & (fits[:, _CONTRAST] >= least_contrast)
    kept &= (fits[:, _OWN_SHARE] > _OWN_LEAST) & (cells[:, CORE] >= _CORE_SHARE)
    rows = np.flatnonzero(kept)
    along = fits[rows, _COS : _SIN + 1]
    xyz = cells[rows, :3].copy()
    xyz[:, :2] += fits[rows, _OFFSET : _OFFSET + 1] * np.column_stack([-along[:, 1], along[:, 0]])
    return Stripes(xyz, along, fits[rows, _WIDTH], fits[rows, _T], fits[rows, _CONTRAST])


@njit(cache=True, nogil=True)
def _directions(local: NDArray, count: int, least: float, turns: NDArray, alike: NDArray, tried: NDArray) -> None:
    """Write the turns with most cells along them that are about as bright as the middle into `tried`."""
    x, y, level = local[0], local[1], local[2]
    n = 0
    for k in range(count):
        if level[k] > least:
            alike[0, n], alike[1, n] = x[k], y[k]
            n += 1
    votes = np.zeros(_TURNS)
    for turn in range(_TURNS):
        votes[turn] = _along(alike[0, :n], alike[1, :n], turns[turn, 0], turns[turn, 1])
    for k in range(_TRIED):
        best = 0
        for turn in range(1, _TURNS):
            best = turn if votes[turn] > votes[best] else best
        for j in range(3):
            beside = (best + j - 1) % _TURNS
            tried[3 * k + j] = beside
            votes[beside] = -1.0


@njit(cache=True, nogil=True)
def _along(x: NDArray, y: NDArray, c: float, s: float) -> int:
    """Return the number of cells near an axis; without branches, so that the compiler uses vector instructions."""
    n = 0
    for k in range(len(x)):
        n += 1 if abs(y[k] * c - x[k] * s) < _NEAR else 0
    return n


@njit(cache=True, nogil=True)
def _profile(local: NDArray, count: int, c: float, s: float, bins: NDArray, sums: NDArray) -> None:
    """Write cumulative brightness, number and height of the cells by distance across the stripe into `sums`."""
    for b in range(2 * _HALF + 1):
        for axis in range(3):
            sums[b, axis] = 0.0
    x, y, level, z = local[0], local[1], local[2], local[3]
    for k in range(count):  # a loop of its own, in vector instructions
        bins[k] = int(np.floor((y[k] * c - x[k] * s) / _BIN)) + _HALF
    for k in range(count):
        b = bins[k]
        if 0 <= b < 2 * _HALF:
            sums[b + 1, 0] += level[k]
            sums[b + 1, 1] += 1.0
            sums[b + 1, 2] += z[k]
    for b in range(2 * _HALF):
        for axis in range(3):
            sums[b + 1, axis] += sums[b, axis]


@njit(cache=True, nogil=True)
def _slope(sums: NDArray, first: int, last: int, left: float, right: float) -> float:
    """Return the fall per bin that goes on beyond both bands, given their means: the peak of a smooth profile."""
    low, high = max(first - _FLANK, 0), min(last + _FLANK, 2 * _HALF)
    n_left, n_right = sums[first, 1] - sums[low, 1], sums[high, 1] - sums[last, 1]
    if n_left < _LEAST or n_right < _LEAST:
        return 0.0
    fall_left = left - (sums[first, 0] - sums[low, 0]) / n_left
    fall_right = right - (sums[high, 0] - sums[last, 0]) / n_right
    return max(min(fall_left, fall_right), 0.0) / _FLANK


@njit(cache=True, nogil=True)
def _clearest(sums: NDArray, widths: NDArray, c: float, s: float, row: NDArray) -> None:
    """Write the clearest stripe of a direction into `row` if it is clearer than the one there."""
    far = _FLANK + _GAP
    for width in widths:
        w = round(width / _BIN)
        for a in range(max(_HALF - w, far), min(_HALF + 1, 2 * _HALF + 1 - far - w)):
            e = a + w
            n, n_left = sums[e, 1] - sums[a, 1], sums[a - _GAP, 1] - sums[a - far, 1]
            n_right = sums[e + far, 1] - sums[e + _GAP, 1]
            if n < _LEAST or n_left < _LEAST or n_right < _LEAST:
                continue
            # Either half of a wide stripe is brighter than its band; a ridge of a border and a slope is not.
            half = w if w < _SPLIT else w // 2
            n_first, n_last = sums[a + half, 1] - sums[a, 1], sums[e, 1] - sums[e - half, 1]
            if min(n_first, n_last) < 1:
                continue
            band_left = (sums[a - _GAP, 0] - sums[a - far, 0]) / n_left
            band_right = (sums[e + far, 0] - sums[e + _GAP, 0]) / n_right
            slope = 0.0
            if w >= _SPLIT:
                slope = _slope(sums, a - far, e + far, band_left, band_right) * (_GAP + (_FLANK + half) / 2.0)
            left = (sums[a + half, 0] - sums[a, 0]) / n_first - band_left - slope
            right = (sums[e, 0] - sums[e - half, 0]) / n_last - band_right - slope
            if left <= 0.0 or right <= 0.0:
                continue
            t = min(left / np.sqrt(1.0 / n + 1.0 / n_left), right / np.sqrt(1.0 / n + 1.0 / n_right))
            if t > row[_T]:
                low = (sums[a - _GAP, 2] - sums[a - far, 2]) / n_left
                high = (sums[e + far, 2] - sums[e + _GAP, 2]) / n_right
                row[_T], row[_COS], row[_SIN] = t, c, s
                row[_OFFSET], row[_WIDTH] = ((a + e) / 2.0 - _HALF) * _BIN, width
                row[_CONTRAST] = min(left, right) if abs(low - high) < _LEVEL else 0.0
                row[_OWN_SHARE] = (sums[e, 0] - sums[a, 0]) / n


@njit(cache=True, nogil=True)
def _own_share(local: NDArray, count: int, row: NDArray) -> float:
    """Return the contrast of the stripe beside the cell itself as a share of that of the whole stripe."""
    total, n = 0.0, 0
    for k in range(count):
        x, y = local[0, k], local[1, k]
        across, along = y * row[_COS] - x * row[_SIN] - row[_OFFSET], x * row[_COS] + y * row[_SIN]
        if abs(across) <= row[_WIDTH] / 2 and abs(along) < _OWN:
            total, n = total + local[2, k], n + 1
    return 1.0 + (total / max(n, 1) - row[_OWN_SHARE]) / max(row[_CONTRAST], 1e-9)


@njit(cache=True, nogil=True)
def _nearby(near: NDArray, n_near: int, cell: NDArray, local: NDArray) -> int:
    """Write x, y, brightness and z of the cells around a cell, relative to it, into `local`; return their number."""
    count = 0
    for k in range(n_near):
        x, y, z = near[0, k] - cell[X], near[1, k] - cell[Y], near[2, k] - cell[Z]
        if x * x + y * y < REACH * REACH and abs(z) < 0.3:
            local[0, count], local[1, count], local[3, count] = x, y, z
            local[2, count] = (near[3, k] - cell[LEVEL]) / cell[DEVIATION]
            count += 1
    return count


@njit(cache=True, nogil=True)
def _fit(
    cells: NDArray, order: NDArray, keys: NDArray, starts: NDArray, nx: int, widths: NDArray, least: float
) -> NDArray[np.float64]:
    """Return the clearest stripe at each bright cell of the core; zeros for other cells."""
    fits = np.zeros((len(cells), 7))
    found, bins = np.empty(_MOST, np.int64), np.empty(_MOST, np.int64)
    near, local, alike = np.empty((4, _MOST)), np.empty((4, _MOST)), np.empty((2, _MOST))
    sums, tried = np.zeros((2 * _HALF + 1, 3)), np.zeros(3 * _TRIED, np.int64)
    turns = np.empty((_TURNS, 2))
    for k in range(_TURNS):
        turns[k, 0], turns[k, 1] = np.cos(np.pi * k / _TURNS), np.sin(np.pi * k / _TURNS)
    for block in range(len(keys)):
        n_near = -1  # gathered for the first bright cell of the block
        for i in range(starts[block], starts[block + 1]):
            own = order[i]
            if cells[own, BRIGHTNESS] < least or not cells[own, CORE] >= _CORE_SHARE:
                continue
            if n_near < 0:
                n_near = gather_cells(keys[block], nx, np.int64(1), keys, starts, order, found)
                for k in range(n_near):
                    near[0, k], near[1, k] = cells[found[k], X], cells[found[k], Y]
                    near[2, k], near[3, k] = cells[found[k], Z], cells[found[k], LEVEL]
            count = _nearby(near, n_near, cells[own], local)
            _directions(local, count, -_ALIKE * cells[own, BRIGHTNESS], turns, alike, tried)
            row = fits[own]
            for turn in tried:
                c, s = turns[turn, 0], turns[turn, 1]
                _profile(local, count, c, s, bins, sums)
                _clearest(sums, widths, c, s, row)
            row[_OWN_SHARE] = _own_share(local, count, row)
    return fits
