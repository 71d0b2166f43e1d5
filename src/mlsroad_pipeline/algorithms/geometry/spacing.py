"""Mean distance to the nearest points: points of a block share their candidates."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.cells import bounding_box
from mlsroad_pipeline.algorithms.geometry.sorting import radix_argsort
from mlsroad_pipeline.algorithms.geometry.threads import run_in_chunks

_BLOCK = 8  # points of a block, and blocks or nodes below a node
_BITS = 18  # of the Morton code per axis
_FLAGS = {"nnan", "nsz", "contract", "reassoc"}
_RUN = 512  # points in the order of their codes that are split into blocks
_LOOSE = 2.0  # a block wider than this, in distances to the farthest neighbour, is searched point by point
_SLACK = 1.0 + 1e-12  # bounds are sums of rounded distances
_STACK = 256


@njit(cache=True, nogil=True)
def _spread(value: int) -> np.uint64:
    """Put two zero bits between the lowest 21 bits."""
    x = np.uint64(value) & np.uint64(0x1FFFFF)
    x = (x | (x << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
    x = (x | (x << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
    x = (x | (x << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    x = (x | (x << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (x | (x << np.uint64(2))) & np.uint64(0x1249249249249249)


@njit(cache=True, nogil=True)
def _morton_codes(xyz: NDArray, minimum: NDArray, scale: float) -> NDArray[np.int64]:
    codes = np.empty(len(xyz), np.int64)
    for i in range(len(xyz)):
        x = _spread(np.int64((xyz[i, 0] - minimum[0]) * scale))
        y = _spread(np.int64((xyz[i, 1] - minimum[1]) * scale))
        z = _spread(np.int64((xyz[i, 2] - minimum[2]) * scale))
        codes[i] = np.int64(x | (y << np.uint64(1)) | (z << np.uint64(2)))
    return codes


@njit(cache=True, nogil=True)
def _swap(points: NDArray, order: NDArray, i: int, j: int) -> None:
    for axis in range(3):
        points[axis, i], points[axis, j] = points[axis, j], points[axis, i]
    order[i], order[j] = order[j], order[i]


@njit(cache=True, nogil=True)
def _split_at(points: NDArray, order: NDArray, axis: int, low: int, high: int, at: int) -> None:
    """Move the points from low to high - 1 so that none before `at` lies beyond the one at `at` (quickselect)."""
    high -= 1
    while low < high:
        pivot = points[axis, (low + high) // 2]
        i, j = low, high
        while i <= j:
            while points[axis, i] < pivot:
                i += 1
            while points[axis, j] > pivot:
                j -= 1
            if i <= j:
                _swap(points, order, i, j)
                i += 1
                j -= 1
        if at <= j:
            high = j
        elif at >= i:
            low = i
        else:
            return


@njit(cache=True, nogil=True)
def _split_runs(points: NDArray, order: NDArray, begin: int, end: int) -> None:
    """Split runs of points at the median of their longest axis, down to blocks, so that blocks are compact."""
    n = points.shape[1]
    for run in range(begin, end):
        length = _RUN
        while length > _BLOCK:
            for low in range(run * _RUN, min(n, (run + 1) * _RUN), length):
                high, at = min(n, low + length), low + length // 2
                if at >= high:
                    continue
                axis, widest = 0, -1.0
                for k in range(3):
                    least, most = np.inf, -np.inf
                    for i in range(low, high):
                        least, most = min(least, points[k, i]), max(most, points[k, i])
                    if most - least > widest:
                        axis, widest = k, most - least
                _split_at(points, order, axis, low, high, at)
            length //= 2


@njit(cache=True, nogil=True)
def _boxes_of_blocks(points: NDArray, boxes: NDArray) -> None:
    """Write the boxes of the blocks of points, of `_BLOCK` blocks per row."""
    n = points.shape[1]
    for block in range(-(-n // _BLOCK)):
        for axis in range(3):
            low, high = np.inf, -np.inf
            for i in range(block * _BLOCK, min(n, (block + 1) * _BLOCK)):
                low, high = min(low, points[axis, i]), max(high, points[axis, i])
            boxes[block // _BLOCK, axis, block % _BLOCK] = low
            boxes[block // _BLOCK, axis + 3, block % _BLOCK] = high


@njit(cache=True, nogil=True)
def _boxes_of_rows(below: NDArray, boxes: NDArray) -> None:
    """Write the boxes of rows of boxes."""
    for row in range(len(below)):
        for axis in range(3):
            low, high = np.inf, -np.inf
            for i in range(_BLOCK):
                low, high = min(low, below[row, axis, i]), max(high, below[row, axis + 3, i])
            boxes[row // _BLOCK, axis, row % _BLOCK] = low
            boxes[row // _BLOCK, axis + 3, row % _BLOCK] = high


def _build(points: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return a tree of boxes in rows of `_BLOCK`, those of blocks first, and the first row of each level."""
    n_rows = [-(-points.shape[1] // _BLOCK**2)]
    while n_rows[-1] > 1:
        n_rows.append(-(-n_rows[-1] // _BLOCK))
    starts = np.concatenate([[0], np.cumsum(n_rows)]).astype(np.int64)
    boxes = np.full((starts[-1], 6, _BLOCK), np.inf, np.float32)  # an absent box is infinitely far
    _boxes_of_blocks(points, boxes[: starts[1]])
    for level in range(1, len(n_rows)):
        _boxes_of_rows(boxes[starts[level - 1] : starts[level]], boxes[starts[level] : starts[level + 1]])
    return boxes, starts


@njit(cache=True, nogil=True, fastmath=_FLAGS)
def _box_distances(box: NDArray, x: float, y: float, z: float, near: NDArray) -> None:
    """Write the squared distances of a row of boxes."""
    for child in range(_BLOCK):
        dx = max(box[0, child] - x, x - box[3, child], np.float32(0.0))
        dy = max(box[1, child] - y, y - box[4, child], np.float32(0.0))
        dz = max(box[2, child] - z, z - box[5, child], np.float32(0.0))
        near[child] = dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True)
def _gather(
    points: NDArray, boxes: NDArray, starts: NDArray, centre: int, radius: float, found: NDArray, work: tuple
) -> tuple[NDArray, int]:
    """Collect the points within a radius of one, with their squared distances; return the rows and their number."""
    n, limit = points.shape[1], radius * radius
    near, stack = work
    x, y, z = points[0, centre], points[1, centre], points[2, centre]
    box_limit = np.float32(limit * (1.0 + 1e-5) + 1e-12)  # boxes are rounded
    stack[0, 0], stack[0, 1], top, m = len(starts) - 2, 0, 1, 0
    while top > 0:
        top -= 1
        level, row = stack[top, 0], stack[top, 1]
        _box_distances(boxes[starts[level] + row], np.float32(x), np.float32(y), np.float32(z), near)
        if level > 0:
            for child in range(_BLOCK):
                stack[top, 0], stack[top, 1] = level - 1, row * _BLOCK + child
                top += near[child] <= box_limit
            continue
        if m + _BLOCK * _BLOCK > found.shape[1]:
            larger = np.empty((4, 2 * found.shape[1]))
            larger[:, :m] = found[:, :m]
            found = larger
        for child in range(_BLOCK):
            if near[child] <= box_limit:
                first = (row * _BLOCK + child) * _BLOCK
                for i in range(first, min(n, first + _BLOCK)):
                    px, py, pz = points[0, i], points[1, i], points[2, i]
                    found[0, m], found[1, m], found[2, m] = px, py, pz
                    d = (px - x) * (px - x) + (py - y) * (py - y) + (pz - z) * (pz - z)
                    found[3, m] = d
                    m += d <= limit
    return found, m


@njit(cache=True, nogil=True, fastmath=_FLAGS)
def _write_distances(found: NDArray, m: int, x: float, y: float, z: float, squared: NDArray) -> None:
    for j in range(m):
        dx, dy, dz = found[0, j] - x, found[1, j] - y, found[2, j] - z
        squared[j] = dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True, fastmath=_FLAGS)
def _count(squared: NDArray, m: int, limit: float) -> int:
    n = 0
    for j in range(m):
        n += 1 if squared[j] <= limit else 0
    return n


@njit(cache=True, nogil=True, fastmath=_FLAGS)
def _sum_roots(squared: NDArray, m: int, limit: float) -> float:
    total = 0.0
    for j in range(m):
        total += np.sqrt(squared[j]) if squared[j] <= limit else 0.0
    return total


@njit(cache=True, nogil=True)
def _smallest(squared: NDArray, m: int, k: int, limit: float) -> tuple[float, float]:
    """Return the sum of the roots of the k smallest values, and a limit of their roots, from one that holds k or more.

    A limit that holds exactly k values is interpolated: on a surface, their number grows with the squared distance.
    Of equal values at the limit, as many count as are missing.
    """
    low, n_low, high, n_high = 0.0, _count(squared, m, 0.0), limit, _count(squared, m, limit)
    if n_low >= k:
        return 0.0, 0.0
    while n_high > k:
        share = min(max((k - n_low + 0.5) / (n_high - n_low + 1), 0.05), 0.95)
        middle = low + (high - low) * share
        if middle <= low or middle >= high:  # neighbouring numbers: the values between are equal
            return _sum_roots(squared, m, low) + (k - n_low) * np.sqrt(high), np.sqrt(high)
        n = _count(squared, m, middle)
        if n < k:
            low, n_low = middle, n
        else:
            high, n_high = middle, n
    return _sum_roots(squared, m, high), np.sqrt(high)


@njit(cache=True, nogil=True)
def _bound(points: NDArray, at: int, k: int, squared: NDArray) -> float:
    """Return a radius that holds the k nearest points of one, from those beside it in the order of the blocks."""
    n = points.shape[1]
    low = max(0, min(at - k, n - 2 * k))
    m, high = min(n, low + 2 * k) - low, 0.0
    for j in range(m):
        i = low + j
        dx, dy, dz = points[0, i] - points[0, at], points[1, i] - points[1, at], points[2, i] - points[2, at]
        squared[j] = dx * dx + dy * dy + dz * dz
        high = max(high, squared[j])
    return _smallest(squared, m, k, high)[1]


@njit(cache=True, nogil=True)
def _middle_of(points: NDArray, first: int, last: int) -> int:
    """Return the point of a block that is nearest to the mean of all."""
    x, y, z, n = 0.0, 0.0, 0.0, last - first
    for i in range(first, last):
        x, y, z = x + points[0, i] / n, y + points[1, i] / n, z + points[2, i] / n
    best, least = first, np.inf
    for i in range(first, last):
        dx, dy, dz = points[0, i] - x, points[1, i] - y, points[2, i] - z
        d = dx * dx + dy * dy + dz * dz
        best, least = (i, d) if d < least else (best, least)
    return best


@njit(cache=True, nogil=True)
def _spread_of(points: NDArray, first: int, last: int, middle: int) -> float:
    """Return the largest distance of the points of a block to the middle one."""
    farthest = 0.0
    for i in range(first, last):
        dx, dy, dz = (
            points[0, i] - points[0, middle],
            points[1, i] - points[1, middle],
            points[2, i] - points[2, middle],
        )
        farthest = max(farthest, dx * dx + dy * dy + dz * dz)
    return np.sqrt(farthest)


@njit(cache=True, nogil=True)
def _spacings(
    points: NDArray, boxes: NDArray, starts: NDArray, k: int, rows: NDArray, spacing: NDArray, begin: int, end: int
) -> None:
    """Write the mean distance to the k nearest points for the points of some blocks."""
    n = points.shape[1]
    found, squared = np.empty((4, 1024)), np.empty(max(1024, 2 * k))
    work = (np.empty(_BLOCK, np.float32), np.empty((_STACK, 2), np.int64))
    for block in range(begin, end):
        first, last = block * _BLOCK, min(n, (block + 1) * _BLOCK)
        middle, m = _middle_of(points, first, last), 0
        near = _bound(points, middle, k, squared) * _SLACK
        spread = _spread_of(points, first, last, middle)
        shared = spread <= _LOOSE * near
        if shared:
            found, m = _gather(points, boxes, starts, middle, near, found, work)
            near = _smallest(found[3], m, k, near * near)[1]
            found, m = _gather(points, boxes, starts, middle, (near + 2.0 * spread) * _SLACK, found, work)
        for i in range(first, last):
            x, y, z = points[0, i], points[1, i], points[2, i]
            if shared:
                dx, dy, dz = x - points[0, middle], y - points[1, middle], z - points[2, middle]
                radius = (near + np.sqrt(dx * dx + dy * dy + dz * dz)) * _SLACK
            else:
                radius = _bound(points, i, k, squared) * _SLACK
                found, m = _gather(points, boxes, starts, i, radius, found, work)
            if len(squared) < found.shape[1]:
                squared = np.empty(found.shape[1])
            _write_distances(found, m, x, y, z, squared)
            spacing[rows[i]] = _smallest(squared, m, k, radius * radius)[0] / k


def mean_spacing(xyz: NDArray[np.float64], *, k: int, n_threads: int = 1) -> NDArray[np.float64]:
    """Return the mean distance of each point to its k nearest points, itself included."""
    low, high = bounding_box(xyz)
    scale = (2**_BITS - 1) / max(float((high - low).max()), 1e-9)
    _, order = radix_argsort(_morton_codes(xyz, low, scale), 3 * _BITS)
    points = np.ascontiguousarray((xyz - low).T[:, order])
    run_in_chunks(lambda begin, end: _split_runs(points, order, begin, end), -(-len(xyz) // _RUN), n_threads=n_threads)
    boxes, starts = _build(points)
    spacing = np.empty(len(xyz))

    def run(begin: int, end: int) -> None:
        _spacings(points, boxes, starts, k, order, spacing, begin, end)

    run_in_chunks(run, -(-len(xyz) // _BLOCK), n_threads=n_threads)
    return spacing
