"""Compiled kernels of the fast point feature histograms.

Points are sorted by cell, in float32 relative to the centre of their cell. For each cell, all points within reach are
copied once into buffers. The following loops run over contiguous memory without branches and vectorise. Both passes
test distances; storing neighbour lists would cost more.
"""

from math import sqrt
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.features.eigen_solver import FAST
from mlsroad_pipeline.algorithms.geometry.cells import first_window, most_near, move_window

_BLOCK = 256
"""Pairs per block."""
_COPIES = 2
"""Copies of a histogram, used alternately to avoid store-to-load dependencies."""
_HALF_PI, _PI = np.float32(np.pi / 2), np.float32(np.pi)
_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
_FAR = np.float32(np.inf)
# Minimax polynomial of atan(t) / t in t^2 for t in [0, 1]; accurate to 1e-7 in float32.
_C0, _C1, _C2 = np.float32(0.99999989), np.float32(-0.33332597), np.float32(0.19985907)
_C3, _C4, _C5 = np.float32(-0.14161229), np.float32(0.10498945), np.float32(-0.07234856)
_C6, _C7, _C8 = np.float32(0.0397812), np.float32(-0.01440135), np.float32(0.00245672)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _atan2(y: Any, x: Any) -> Any:
    """Return the angle of (x, y), 0 for (0, 0), by a polynomial that vectorises."""
    ax, ay = abs(x), abs(y)
    steep = ay > ax
    larger = max(ax, ay)
    t = min(ax, ay) / (larger if larger > _ZERO else _ONE)
    s = t * t
    p = _C4 + s * (_C5 + s * (_C6 + s * (_C7 + s * _C8)))
    a = t * (_C0 + s * (_C1 + s * (_C2 + s * (_C3 + s * p))))
    a = _HALF_PI - a if steep else a
    a = _PI - a if x < _ZERO else a
    return -a if y < _ZERO else a


@njit(cache=True, nogil=True)
def _collect(near: NDArray, squares: NDArray, hits: NDArray, start: int, stop: int, own: int, pairs: NDArray) -> None:
    """Copy offsets, normals and squared distances of neighbours into contiguous rows."""
    px, py, pz, nx, ny, nz = near[0], near[1], near[2], near[3], near[4], near[5]
    x, y, z = px[own], py[own], pz[own]
    for m in range(stop - start):
        k = np.uintp(hits[start + m])  # unsigned: no test for negative indices
        pairs[m] = px[k] - x
        pairs[_BLOCK + m] = py[k] - y
        pairs[2 * _BLOCK + m] = pz[k] - z
        pairs[3 * _BLOCK + m] = nx[k]
        pairs[4 * _BLOCK + m] = ny[k]
        pairs[5 * _BLOCK + m] = nz[k]
        pairs[6 * _BLOCK + m] = squares[k]


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _bin_pairs(
    pairs: NDArray, n_pairs: int, ax: float, ay: float, az: float, n_bins: int, radius: float, bins: NDArray
) -> None:
    """Write the bins of the pair features of a point with each of its neighbours (Rusu et al. 2009, equation 1)."""
    n, last = np.float32(n_bins), np.int32(n_bins - 1)
    turn, per_radius = n / (_PI + _PI), n / np.float32(radius)
    for m in range(n_pairs):
        dx, dy, dz = pairs[m], pairs[_BLOCK + m], pairs[2 * _BLOCK + m]
        bx, by, bz = pairs[3 * _BLOCK + m], pairs[4 * _BLOCK + m], pairs[5 * _BLOCK + m]
        along, other = ax * dx + ay * dy + az * dz, bx * dx + by * dy + bz * dz
        # The source is the point whose normal is closer to the connecting line.
        swap = abs(along) < abs(other)
        sx, sy, sz = bx if swap else ax, by if swap else ay, bz if swap else az
        tx, ty, tz = ax if swap else bx, ay if swap else by, az if swap else bz
        third = -other if swap else along
        sign = -_ONE if swap else _ONE
        vx, vy, vz = sign * (dy * sz - dz * sy), sign * (dz * sx - dx * sz), sign * (dx * sy - dy * sx)
        length = vx * vx + vy * vy + vz * vz
        flat = not length > _ZERO
        scale = _ZERO if flat else _ONE / np.float32(sqrt(_ONE if flat else length))
        vx, vy, vz = vx * scale, vy * scale, vz * scale
        wx, wy, wz = sy * vz - sz * vy, sz * vx - sx * vz, sx * vy - sy * vx
        cosine = sx * tx + sy * ty + sz * tz
        first = _atan2(wx * tx + wy * ty + wz * tz, _ONE if flat else cosine)
        second = vx * tx + vy * ty + vz * tz
        distance = np.float32(sqrt(pairs[6 * _BLOCK + m]))
        third = _ZERO if flat else third / distance
        bins[m] = min(max(np.int32((first + _PI) * turn), np.int32(0)), last)
        bins[_BLOCK + m] = min(max(np.int32((second + _ONE) * _HALF * n), np.int32(0)), last)
        bins[2 * _BLOCK + m] = min(max(np.int32((third + _ONE) * _HALF * n), np.int32(0)), last)
        bins[3 * _BLOCK + m] = min(np.int32(distance * per_radius), last)


@njit(cache=True, nogil=True)
def _count(bins: NDArray, n_pairs: int, n_bins: int, n_features: int, counts: NDArray) -> None:
    """Count the pairs of each bin."""
    second, third, fourth = np.uintp(n_bins), np.uintp(2 * n_bins), np.uintp(3 * n_bins)
    one, two = counts[0], counts[1]
    for m in range(0, n_pairs - 1, 2):  # alternate copies: independent increments
        one[np.uintp(bins[m])] += 1
        one[second + np.uintp(bins[_BLOCK + m])] += 1
        one[third + np.uintp(bins[2 * _BLOCK + m])] += 1
        two[np.uintp(bins[m + 1])] += 1
        two[second + np.uintp(bins[_BLOCK + m + 1])] += 1
        two[third + np.uintp(bins[2 * _BLOCK + m + 1])] += 1
    if n_pairs & 1:
        m = n_pairs - 1
        one[np.uintp(bins[m])] += 1
        one[second + np.uintp(bins[_BLOCK + m])] += 1
        one[third + np.uintp(bins[2 * _BLOCK + m])] += 1
    if n_features > 3:
        for m in range(n_pairs):
            one[fourth + np.uintp(bins[3 * _BLOCK + m])] += 1


@njit(cache=True, nogil=True)
def simple_histograms(
    local: NDArray,
    normals: NDArray,
    keys: NDArray,
    starts: NDArray,
    rows: NDArray,
    reach: int,
    size: float,
    radius: float,
    n_bins: int,
    n_features: int,
    first: int,
    last: int,
    out: NDArray,
) -> None:
    """Write the simplified histograms of the points in cells `first` to `last`, in the order of the cells.

    `local` and `normals` are float32 (3, n); `rows` are the rows of cells within `reach`; `n_features` is 3 (angles) or
    4 (with the distance).
    """
    squared = np.float32(radius * radius)
    begin, end = first_window(keys, keys[first], rows, reach)
    counts = np.zeros((_COPIES, n_features * n_bins), np.int32)
    near = np.empty((6, 1), np.float32)
    squares, source, hits = near[0], np.empty(1, np.int32), np.empty(1, np.int32)
    pairs, bins = np.empty(7 * _BLOCK, np.float32), np.empty(4 * _BLOCK, np.int32)
    for cell in range(first, last):
        move_window(keys, keys[cell], rows, reach, begin, end)
        bound = most_near(starts, begin, end)
        if bound > near.shape[1]:
            near = np.empty((6, 2 * bound), np.float32)
            squares, source = np.empty(2 * bound, np.float32), np.empty(2 * bound, np.int32)
            hits = np.empty(2 * bound, np.int32)
        n_near, own = gather(local, starts, keys, cell, rows, begin, end, size, squared, near, source)
        for axis in range(3):
            for k in range(n_near):
                near[3 + axis, k] = normals[axis, source[k]]
        for i in range(starts[cell], starts[cell + 1]):
            at = own + i - starts[cell]
            distances(near, n_near, at, squares)
            squares[at] = _FAR
            n_hits = 0
            for k in range(n_near):
                hits[n_hits] = k
                n_hits += squares[k] <= squared
            counts[:] = 0
            for start in range(0, n_hits, _BLOCK):
                stop = min(start + _BLOCK, n_hits)
                _collect(near, squares, hits, start, stop, at, pairs)
                _bin_pairs(pairs, stop - start, near[3, at], near[4, at], near[5, at], n_bins, radius, bins)
                _count(bins, stop - start, n_bins, n_features, counts)
            scale = _ONE / np.float32(max(n_hits, 1))
            for b in range(out.shape[1]):
                out[i, b] = np.float32(counts[0, b] + counts[1, b]) * scale


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _add_neighbors(
    squares: NDArray, source: NDArray, hits: NDArray, n_hits: int, simple: NDArray, total: NDArray
) -> None:
    """Sum the histograms of the neighbours, each divided by its squared distance, four at a time."""
    m = 0
    while m + 4 <= n_hits:
        a, b, c, d = np.uintp(hits[m]), np.uintp(hits[m + 1]), np.uintp(hits[m + 2]), np.uintp(hits[m + 3])
        wa, wb, wc, wd = _ONE / squares[a], _ONE / squares[b], _ONE / squares[c], _ONE / squares[d]
        ra, rb, rc, rd = simple[source[a]], simple[source[b]], simple[source[c]], simple[source[d]]
        for j in range(len(total)):
            total[j] += (wa * ra[j] + wb * rb[j]) + (wc * rc[j] + wd * rd[j])
        m += 4
    while m < n_hits:
        weight, row = _ONE / squares[hits[m]], simple[source[hits[m]]]
        for j in range(len(total)):
            total[j] += weight * row[j]
        m += 1


@njit(cache=True, nogil=True)
def weighted_histograms(
    local: NDArray,
    order: NDArray,
    keys: NDArray,
    starts: NDArray,
    rows: NDArray,
    reach: int,
    size: float,
    radius: float,
    simple: NDArray,
    n_bins: int,
    first: int,
    last: int,
    out: NDArray,
) -> None:
    """Write the histograms of the points in cells `first` to `last` from simplified histograms `simple`.

    `order` holds the row of `out` of each point. Each row sums to 1, or to 0 without neighbours.
    """
    squared = np.float32(radius * radius)
    begin, end = first_window(keys, keys[first], rows, reach)
    width = simple.shape[1]
    share = np.float32(n_bins / width)
    total = np.empty(width, np.float32)
    near = np.empty((3, 1), np.float32)
    squares, source, hits = near[0], np.empty(1, np.int32), np.empty(1, np.int32)
    for cell in range(first, last):
        move_window(keys, keys[cell], rows, reach, begin, end)
        bound = most_near(starts, begin, end)
        if bound > near.shape[1]:
            near = np.empty((3, 2 * bound), np.float32)
            squares, source = np.empty(2 * bound, np.float32), np.empty(2 * bound, np.int32)
            hits = np.empty(2 * bound, np.int32)
        n_near, own = gather(local, starts, keys, cell, rows, begin, end, size, squared, near, source)
        for i in range(starts[cell], starts[cell + 1]):
            distances(near, n_near, own + i - starts[cell], squares)
            n_hits = 0
            for k in range(n_near):
                hits[n_hits] = k
                n_hits += (squares[k] <= squared) & (squares[k] > _ZERO)
            total[:] = _ZERO
            _add_neighbors(squares, source, hits, n_hits, simple, total)
            weight = _ZERO
            for b in range(n_bins):  # all features have the same sum: each counts every pair once
                weight += total[b]
            row = out[order[i]]
            if weight > _ZERO:
                half, factor = _HALF * share, _HALF * share / weight
                for b in range(width):
                    row[b] = total[b] * factor + simple[i, b] * half
            else:
                for b in range(width):
                    row[b] = simple[i, b] * share


@njit(cache=True, nogil=True, fastmath=FAST)
def gather(
    local: NDArray,
    starts: NDArray,
    keys: NDArray,
    cell: int,
    rows: NDArray,
    begin: NDArray,
    end: NDArray,
    size: float,
    squared: float,
    near: NDArray,
    source: NDArray,
) -> tuple[int, int]:
    """Copy the candidate neighbours of a cell; return their number and the start of the points of the cell itself."""
    n_near, own = 0, 0
    half = np.float32(0.5 * size)
    near_x, near_y, near_z = near[0], near[1], near[2]
    for j in range(len(rows)):
        shift_y, shift_z = np.float32(rows[j, 0] * size), np.float32(rows[j, 1] * size)
        for other in range(begin[j], end[j]):
            shift_x = np.float32((keys[other] - keys[cell] - rows[j, 2]) * size)
            if other == cell:
                own = n_near
            for i in range(starts[other], starts[other + 1]):
                x, y, z = local[0, i] + shift_x, local[1, i] + shift_y, local[2, i] + shift_z
                near_x[n_near], near_y[n_near], near_z[n_near] = x, y, z
                source[n_near] = i
                gx, gy, gz = max(abs(x) - half, _ZERO), max(abs(y) - half, _ZERO), max(abs(z) - half, _ZERO)
                n_near += gx * gx + gy * gy + gz * gz <= squared
    return n_near, own


@njit(cache=True, nogil=True, fastmath=FAST)
def distances(near: NDArray, n_near: int, own: int, squares: NDArray) -> None:
    """Write the squared distances of all candidates from one of them."""
    near_x, near_y, near_z = near[0], near[1], near[2]
    x, y, z = near_x[own], near_y[own], near_z[own]
    for k in range(n_near):
        dx, dy, dz = near_x[k] - x, near_y[k] - y, near_z[k] - z
        squares[k] = dx * dx + dy * dy + dz * dz
