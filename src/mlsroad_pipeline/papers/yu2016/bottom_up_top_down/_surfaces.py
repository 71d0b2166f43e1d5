"""Kernels of the bottom-up and top-down detector: even samples, nearest images, overlap of aligned surfaces."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def spread_evenly(points: NDArray[np.float64], bounds: NDArray[np.int64], most: int) -> NDArray[np.bool_]:
    """Return up to `most` points of each object by farthest-point sampling from the lowest point."""
    chosen = np.zeros(len(points), np.bool_)
    for o in range(len(bounds) - 1):
        first, last = bounds[o], bounds[o + 1]
        if last - first <= most:
            chosen[first:last] = True
            continue
        away = np.full(last - first, np.inf)
        at = int(np.argmin(points[first:last, 2]))
        for _ in range(most):
            chosen[first + at] = True
            x, y, z = points[first + at, 0], points[first + at, 1], points[first + at, 2]
            farthest = -1.0
            for i in range(last - first):
                dx, dy, dz = points[first + i, 0] - x, points[first + i, 1] - y, points[first + i, 2] - z
                away[i] = min(away[i], dx * dx + dy * dy + dz * dz)
                if away[i] > farthest:
                    farthest, at = away[i], i
    return chosen


@njit(cache=True, nogil=True)
def nearest_images(
    images: NDArray[np.float32],
    owner: NDArray[np.int32],
    database: NDArray[np.float32],
    database_owner: NDArray[np.int32],
    out: NDArray[np.int32],
    start: int,
    stop: int,
) -> None:
    """Write the nearest image of the database that belongs to another object; -1 for none."""
    width = images.shape[1]
    for q in range(start, stop):
        best = np.float32(np.inf)
        nearest = -1
        for d in range(len(database)):
            if database_owner[d] == owner[q]:
                continue
            total = np.float32(0.0)
            j = 0
            while j < width and total < best:
                for i in range(j, min(j + 17, width)):
                    step = images[q, i] - database[d, i]
                    total += step * step
                j += 17
            if total < best:
                best, nearest = total, d
        out[q] = nearest


@njit(cache=True, nogil=True)
def _near(points: NDArray, n: int, others: NDArray, m: int, reach: float, shift: NDArray, move: NDArray) -> float:
    """Return the sum of nearest-neighbour weights of shifted points, 1 to 0 at `reach`; write their mean offset."""
    gain, matched = 0.0, 0.0
    move[:] = 0.0
    for i in range(n):
        best, nearest = reach * reach, -1
        x, y, z = points[i, 0] + shift[0], points[i, 1] + shift[1], points[i, 2] + shift[2]
        for j in range(m):
            dx, dy, dz = others[j, 0] - x, others[j, 1] - y, others[j, 2] - z
            squared = dx * dx + dy * dy + dz * dz
            if squared < best:
                best, nearest = squared, j
        if nearest >= 0:
            gain += 1.0 - np.sqrt(best) / reach
            matched += 1.0
            move[0] += others[nearest, 0] - x
            move[1] += others[nearest, 1] - y
            move[2] += others[nearest, 2] - z
    if matched > 0.0:
        for axis in range(3):
            move[axis] /= matched
    return gain


@njit(cache=True, nogil=True)
def overlap_surfaces(
    models: NDArray[np.float64],
    model_bounds: NDArray[np.int64],
    points: NDArray[np.float64],
    bounds: NDArray[np.int64],
    turns: NDArray[np.float64],
    wanted: NDArray[np.bool_],
    reach: float,
    n_steps: int,
    out: NDArray[np.float64],
    start: int,
    stop: int,
) -> None:
    """Write the mutual overlap of rotated models and objects, 0 to 1, the larger for the angle and its opposite."""
    shift, back, move = np.zeros(3), np.zeros(3), np.zeros(3)
    for o in range(start, stop):
        mine = points[bounds[o] : bounds[o + 1]]
        m = len(mine)
        for p in range(out.shape[1]):
            model = models[model_bounds[p] : model_bounds[p + 1]]
            n = len(model)
            if n == 0 or m == 0 or not wanted[o, p]:
                continue
            turned = np.empty((n, 3))
            for half in range(2):
                angle = turns[o, p] + half * np.pi
                cosine, sine = np.cos(angle), np.sin(angle)
                for i in range(n):
                    turned[i, 0] = cosine * model[i, 0] - sine * model[i, 1]
                    turned[i, 1] = sine * model[i, 0] + cosine * model[i, 1]
                    turned[i, 2] = model[i, 2]
                shift[:] = 0.0
                for _ in range(n_steps + 1):
                    gain = _near(turned, n, mine, m, reach, shift, move)
                    for axis in range(3):
                        back[axis] = -shift[axis]
                        shift[axis] += move[axis]
                    gain_back = _near(mine, m, turned, n, reach, back, move)
                    out[o, p] = max(out[o, p], min(gain / n, gain_back / m))
