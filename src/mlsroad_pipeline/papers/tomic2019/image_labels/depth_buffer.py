"""Kernels of the depth buffer: discs, and gaps between them."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

_LARGEST = 12.0  # maximum radius of a disc, cells; bounds the work for points close to the camera
_BLOCK = 20  # side of a block for point counts, cells
_SHELL, _SHELLS = 1.2, 32  # ratio of successive shells of depth and their number: 1 m to 340 m
_FILLED = 8  # minimum points of a filled block
_STEPS = np.array([1, 2, 4, 7, 12, 20], dtype=np.int64)  # distances of the search for the sides of a gap, cells


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_discs(
    u: NDArray[np.float32], v: NDArray[np.float32], z: NDArray[np.float32],
    focal: float, diameter: float, width: int, height: int,
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:  # fmt: skip
    """Return the point with the nearest disc in each cell, and its depth."""
    depth = np.full((height, width), np.float32(np.inf))
    index = np.full((height, width), np.int32(-1))
    for i in range(len(z)):
        radius = np.float32(min(0.5 * diameter * focal / z[i], _LARGEST))
        left, right = max(int(np.ceil(u[i] - radius)), 0), min(int(np.floor(u[i] + radius)), width - 1)
        top, bottom = max(int(np.ceil(v[i] - radius)), 0), min(int(np.floor(v[i] + radius)), height - 1)
        if right < left:  # a disc smaller than a cell covers one cell
            left = right = _cell(u[i], width)
        if bottom < top:
            top = bottom = _cell(v[i], height)
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                if z[i] < depth[y, x]:
                    if radius > 1 and (x - u[i]) ** 2 + (y - v[i]) ** 2 > radius * radius:
                        continue
                    depth[y, x], index[y, x] = z[i], i
    return index, depth


def typical_spacing(
    u: NDArray[np.float32], v: NDArray[np.float32], z: NDArray[np.float32], *, focal: float, width: int, height: int
) -> float:
    """Return the typical point spacing on surfaces, as seen from the camera.

    Points are counted in blocks of the image and shells of depth. The spacing in a filled block is that of the same
    number of points spread evenly across the line of sight.
    """
    counts = _count_blocks(u, v, z, width, height)
    filled = np.flatnonzero(counts >= _FILLED)
    if len(filled) == 0:
        return 0.0
    depth = _SHELL ** (filled % _SHELLS + 0.5)
    return float(np.median(depth * (_BLOCK / focal) / np.sqrt(counts[filled])))


@njit(cache=True, nogil=True, error_model="numpy")
def _count_blocks(
    u: NDArray[np.float32], v: NDArray[np.float32], z: NDArray[np.float32], width: int, height: int
) -> NDArray[np.int32]:  # fmt: skip
    across, down = width // _BLOCK + 1, height // _BLOCK + 1
    counts = np.zeros(across * down * _SHELLS, dtype=np.int32)
    for i in range(len(z)):
        shell = min(max(int(np.log(z[i]) / np.log(_SHELL)), 0), _SHELLS - 1)
        x, y = _cell(u[i], width) // _BLOCK, _cell(v[i], height) // _BLOCK
        counts[(y * across + x) * _SHELLS + shell] += 1
    return counts


@njit(cache=True, nogil=True, error_model="numpy")
def behind_discs(
    u: NDArray[np.float32], v: NDArray[np.float32], z: NDArray[np.float32], relief: NDArray[np.float32],
    index: NDArray[np.int32], depth: NDArray[np.float32], focal: float, slack: float, relative: float, angle: float,
) -> NDArray[np.bool_]:  # fmt: skip
    """Return which points lie behind the nearest disc of their cell."""
    height, width = index.shape
    hidden = np.zeros(len(z), dtype=np.bool_)
    for i in range(len(z)):
        y, x = _cell(v[i], height), _cell(u[i], width)
        if depth[y, x] < z[i] - slack - relative * z[i]:
            hidden[i] = _beside(u, v, z, relief, index[y, x], i, focal, angle, np.inf)
    return hidden


@njit(cache=True, nogil=True, error_model="numpy")
def hide_in_gaps(
    u: NDArray[np.float32], v: NDArray[np.float32], z: NDArray[np.float32], relief: NDArray[np.float32],
    index: NDArray[np.int32], depth: NDArray[np.float32], focal: float, gap: float, slack: float, relative: float,
    angle: float, sides: int, hidden: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Hide points behind gaps: points with nearer discs on both sides in several directions."""
    height, width = index.shape
    for i in range(len(z)):
        if hidden[i]:
            continue
        x, y, limit = _cell(u[i], width), _cell(v[i], height), z[i] - slack - relative * z[i]
        closed = 0
        for k in range(4):
            dx, dy = (1, 1, 0, -1)[k], (0, 1, 1, 1)[k]
            for sign in (-1, 1):
                nearer = False
                for step in _STEPS:
                    column, row = x + sign * step * dx, y + sign * step * dy
                    if not (0 <= column < width and 0 <= row < height):
                        break
                    if depth[row, column] < limit and _beside(
                        u, v, z, relief, index[row, column], i, focal, angle, gap
                    ):
                        nearer = True
                        break
                if not nearer:
                    break
                closed += sign == 1
            if closed >= sides or closed + 3 - k < sides:
                break
        hidden[i] = closed >= sides


@njit(cache=True, nogil=True, error_model="numpy")
def ground_relief(
    xyz: NDArray[np.floating], rows: NDArray[np.int64], eye: NDArray[np.float64], cell: float, height: float,
    relief: float,
) -> NDArray[np.float32]:  # fmt: skip
    """Return the depth tolerance of ground points against ground in front of them.

    At grazing incidence the line of sight runs within the roughness of the ground over metres.
    """
    out = np.zeros(len(rows), dtype=np.float32)
    if len(rows) == 0:
        return out
    low_x = high_x = xyz[rows[0], 0]
    low_y = high_y = xyz[rows[0], 1]
    for i in rows:
        low_x, high_x = min(low_x, xyz[i, 0]), max(high_x, xyz[i, 0])
        low_y, high_y = min(low_y, xyz[i, 1]), max(high_y, xyz[i, 1])
    nx, ny = int((high_x - low_x) / cell) + 1, int((high_y - low_y) / cell) + 1
    lowest = np.full((nx, ny), np.inf, dtype=np.float32)
    for i in rows:
        a, b = int((xyz[i, 0] - low_x) / cell), int((xyz[i, 1] - low_y) / cell)
        lowest[a, b] = min(lowest[a, b], np.float32(xyz[i, 2] - eye[2]))
    for k in range(len(rows)):
        i = rows[k]
        below = eye[2] - xyz[i, 2]
        a, b = int((xyz[i, 0] - low_x) / cell), int((xyz[i, 1] - low_y) / cell)
        if below > 0 and -below - lowest[a, b] < height:
            aside = np.sqrt((xyz[i, 0] - eye[0]) ** 2 + (xyz[i, 1] - eye[1]) ** 2 + below * below)
            out[k] = relief * aside / below
    return out


@njit(cache=True, nogil=True, inline="always")
def _cell(place: float, size: int) -> int:
    return min(max(int(np.floor(place + np.float32(0.5))), 0), size - 1)


@njit(cache=True, nogil=True, inline="always")
def _beside(
    u: NDArray[np.float32], v: NDArray[np.float32], z: NDArray[np.float32], relief: NDArray[np.float32],
    q: int, i: int, focal: float, angle: float, reach: float,
) -> bool:  # fmt: skip
    """Return whether a nearer point q is beside the line of sight of point i, and not on the same ground or surface."""
    if relief[q] > 0 and z[i] - z[q] < relief[i]:
        return False
    aside = np.sqrt((u[i] - u[q]) ** 2 + (v[i] - v[q]) ** 2) * z[q] / focal
    return aside <= reach and aside < (z[i] - z[q]) * angle
