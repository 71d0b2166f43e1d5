"""Accumulation images of objects, horizontal and vertical, of the whole and of four slices (Luo et al. 2019)."""

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_xyz
from mlsroad_pipeline.algorithms.geometry.threads import run_in_chunks

N_PARTS = 5
"""Images per kind: the whole object, and its four slices of equal height in ascending order."""

_SLICES = N_PARTS - 1

Images = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]


def concatenate_objects(objects: Sequence[ArrayLike]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Concatenate the points of objects; return them and the start of each object. Errors name the object's index."""
    arrays = [check_xyz(points, minimum=1, name=f"object {i}") for i, points in enumerate(objects)]
    indptr = np.zeros(len(arrays) + 1, dtype=np.int64)
    np.cumsum([len(points) for points in arrays], out=indptr[1:])
    xyz = np.concatenate(arrays, dtype=np.float64) if arrays else np.zeros((0, 3))
    return xyz, indptr


def compute_images(
    objects: Sequence[ArrayLike],
    *,
    sizes: tuple[int, int, int] = (16, 8, 16),
    isotropic: bool = False,
    window: tuple[float, float] | None = None,
    bilinear: bool = False,
    printed: bool = False,
    relative: bool = True,
    weights: Sequence[ArrayLike] | None = None,
    n_threads: int = 1,
) -> Images:
    """Compute HSSI, VQAI and VAAI images of objects and of their four slices (Luo et al. 2019, section 3.2).

    An object is normalised to x, y in [-1, 1] and z in [0, 2]. A slice is a quarter of this height, normalised to [0,
    2] again. HSSI counts points by height (row) and distance from the vertical axis (column): equations 3 and 4, read
    as row = floor((beta + 1) / k1) with beta = z - 1. VQAI counts points by x (row) and y (column): equations 5 and 6.
    VAAI sums, in the same cells, the cosine between the vertical and the line from (0, 0, -1) to the point: equations 7
    to 9, with the square root that is missing in equation 7 and cells of edge 2 / R, where equation 8 has 2 / R^2.

    Parameters
    ----------
    objects : sequence of array-like of shape (n_i, 3)
        Points of each object in metres, z up, n_i at least 1.
    sizes : tuple of int, default (16, 8, 16)
        Rows and columns of HSSI, VQAI and VAAI (luo2019: 16, 8, 16). Larger images resolve finer detail, and noise.
    isotropic : bool, default False
        Whether to scale all axes by one factor, which preserves proportions; the largest extent fills its range. The
        paper scales each axis separately, or all objects alike, see `window`.
    window : tuple of float, optional
        Half width and height, in metres, of a common space for all objects: the centre of an object is at x = y = 0,
        its lowest point at z = 0, and points outside are assigned to the nearest cell. The images then depend on the
        size of the object, and `isotropic` has no effect. By default every object fills its space. "Normalized to fixed
        size space" (section 4.5) allows both readings.
    bilinear : bool, default False
        Whether to distribute a point bilinearly over the four surrounding cells, as in spin images (Johnson and Hebert
        1999). This makes images of objects with few points more stable. Outside the outermost cell centres, the weight
        goes to the nearest cells; the sum of an image is unchanged. By default a point counts only in its own cell
        (equations 4, 6 and 8).
    printed : bool, default False
        Whether equations 4, 7 and 8 are taken as printed. Rows of HSSI are floor((beta + 2) / (2 k1)) with beta = z of
        equation 3, so that objects fill the upper half alone. The cosine of VAAI is divided by its denominator once
        more, and its cells of edge 2 / R^2 put nearly all points into the last row and column.
    relative : bool, default True
        Whether to divide sums by the number of points of the object, which removes the dependence on distance (luo2019:
        no). The slices of VQAI add up to the whole.
    weights : sequence of array-like of shape (n_i,), optional
        Weight of each point, such as its intensity; 1 by default.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    hssi, vqai, vaai : ndarray of float32, shape (objects, 5, size, size)
        Images of the whole object, then of its slices in ascending order. An axis without extent maps to its middle:
        objects of one distinct point occupy one cell of the whole and of the third slice.

    Raises
    ------
    DataError
        If an object has no points, is not (n, 3) or is not finite, or weights are not finite or not one per point.
    ParameterError
        If a size or `n_threads` is below 1, or the window is not two lengths above 0.
    """
    xyz, indptr = concatenate_objects(objects)
    each = np.ones(len(xyz)) if weights is None else concatenate_values(weights, indptr, "weights")
    if relative:
        counts = np.diff(indptr)
        each = each / np.repeat(counts, counts)
    return draw_images(
        xyz, indptr, each, sizes=sizes, isotropic=isotropic, window=window, bilinear=bilinear,
        printed=printed, n_threads=n_threads,
    )  # fmt: skip


def concatenate_values(values: Sequence[ArrayLike], indptr: NDArray[np.int64], name: str) -> NDArray[np.float64]:
    """Concatenate one finite value per point of objects; an error names the object's index."""
    if len(values) != len(indptr) - 1:
        raise DataError(f"{name} are given for {len(values)} of {len(indptr) - 1} objects")
    arrays = [
        check_column(v, int(n), f"{name} of object {i}")
        for i, (v, n) in enumerate(zip(values, np.diff(indptr), strict=True))
    ]
    joined = np.concatenate(arrays, dtype=np.float64) if arrays else np.zeros(0)
    if not np.isfinite(joined).all():
        row = int(np.flatnonzero(~np.isfinite(joined))[0])
        raise DataError(f"{name} of object {int(np.searchsorted(indptr, row, side='right')) - 1} has {joined[row]}")
    return joined


def draw_images(
    xyz: NDArray[np.float64],
    indptr: NDArray[np.int64],
    weights: NDArray[np.float64],
    *,
    sizes: tuple[int, int, int],
    isotropic: bool,
    window: tuple[float, float] | None = None,
    bilinear: bool = False,
    printed: bool = False,
    n_threads: int = 1,
) -> Images:
    """Compute the images of concatenated, validated objects; see `compute_images`."""
    if len(sizes) != 3 or min(sizes) < 1:
        raise ParameterError(f"sizes must be three numbers of at least 1, got {sizes!r}")
    half_width, height = (0.0, 0.0) if window is None else window
    if window is not None and not (0 < half_width < np.inf and 0 < height < np.inf):
        raise ParameterError(f"window must be two lengths above 0, got {window!r}")
    n = len(indptr) - 1
    hssi, vqai, vaai = (np.zeros((n, N_PARTS, size, size), dtype=np.float32) for size in sizes)

    def draw(first: int, last: int) -> None:
        _draw(xyz, indptr, weights, hssi, vqai, vaai, isotropic, half_width, height, bilinear, printed, first, last)

    run_in_chunks(draw, n, n_threads=n_threads)
    return hssi, vqai, vaai


@njit(cache=True, nogil=True)
def _scale(
    xyz: NDArray[np.float64], first: int, last: int, isotropic: bool, half_width: float, height: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the middle of the space of an object, and the factors that map each axis to [-1, 1]."""
    middle, factor = np.empty(3), np.empty(3)
    widest = 0.0
    for axis in range(3):
        low = high = xyz[first, axis]
        for i in range(first + 1, last):
            low, high = min(low, xyz[i, axis]), max(high, xyz[i, axis])
        middle[axis] = 0.5 * (low + high)
        factor[axis] = 2.0 / (high - low) if high > low else 0.0
        widest = max(widest, high - low)
        if axis == 2 and half_width > 0.0:
            middle[2] = low + 0.5 * height
    if half_width > 0.0:
        factor[:2], factor[2] = 1.0 / half_width, 2.0 / height
    elif isotropic and widest > 0.0:
        factor[:] = 2.0 / widest
    return middle, factor


@njit(cache=True, nogil=True, inline="always")  # called six times per point; without inlining 50 % slower
def _add(
    sums: NDArray[np.float64], part: int, size: int, row: float, column: float, weight: float, bilinear: bool
) -> None:
    """Add a weight at a position in cell units; the first cell extends from 0 to 1."""
    if not bilinear:
        sums[part, min(int(row), size - 1) * size + min(int(column), size - 1)] += weight
        return
    row, column = min(max(row - 0.5, 0.0), size - 1.0), min(max(column - 0.5, 0.0), size - 1.0)
    i, j = int(row), int(column)
    below, right = row - i, column - j  # shares of the next row and column; 0 in the last
    next_i, next_j = min(i + 1, size - 1), min(j + 1, size - 1)
    sums[part, i * size + j] += weight * (1.0 - below) * (1.0 - right)
    sums[part, i * size + next_j] += weight * (1.0 - below) * right
    sums[part, next_i * size + j] += weight * below * (1.0 - right)
    sums[part, next_i * size + next_j] += weight * below * right


@njit(cache=True, nogil=True, inline="always")
def _cosine(height: float, flat: float, printed: bool) -> float:
    """Return the cosine between the vertical and a line; as printed, equation 7 lacks the square root."""
    square = height**2 + flat
    return height / square if printed else height / np.sqrt(square)


@njit(cache=True, nogil=True)
def _draw(
    xyz: NDArray[np.float64],
    indptr: NDArray[np.int64],
    weights: NDArray[np.float64],
    hssi: NDArray[np.float32],
    vqai: NDArray[np.float32],
    vaai: NDArray[np.float32],
    isotropic: bool,
    half_width: float,
    height: float,
    bilinear: bool,
    printed: bool,
    begin: int,
    end: int,
) -> None:
    n_h, n_q, n_a = hssi.shape[2], vqai.shape[2], vaai.shape[2]
    spin, count, angle = np.zeros((N_PARTS, n_h * n_h)), np.zeros((N_PARTS, n_q * n_q)), np.zeros((N_PARTS, n_a * n_a))
    for k in range(begin, end):
        first, last = indptr[k], indptr[k + 1]
        middle, factor = _scale(xyz, first, last, isotropic, half_width, height)
        spin[:], count[:], angle[:] = 0.0, 0.0, 0.0
        for i in range(first, last):
            weight = weights[i]
            x = (xyz[i, 0] - middle[0]) * factor[0]
            y = (xyz[i, 1] - middle[1]) * factor[1]
            z = (xyz[i, 2] - middle[2]) * factor[2] + 1.0
            if half_width > 0.0:
                x, y, z = min(max(x, -1.0), 1.0), min(max(y, -1.0), 1.0), min(max(z, 0.0), 2.0)
            part = min(int(z * 0.5 * _SLICES), _SLICES - 1)
            within = (z - part * (2.0 / _SLICES)) * _SLICES
            flat = x * x + y * y
            column = np.sqrt(flat) * 0.5 * n_h
            per_unit, shift = (0.25 * n_h, 2.0) if printed else (0.5 * n_h, 0.0)
            _add(spin, 0, n_h, (z + shift) * per_unit, column, weight, bilinear)
            _add(spin, 1 + part, n_h, (within + shift) * per_unit, column, weight, bilinear)
            row, column = (x + 1.0) * 0.5 * n_q, (y + 1.0) * 0.5 * n_q
            _add(count, 0, n_q, row, column, weight, bilinear)
            _add(count, 1 + part, n_q, row, column, weight, bilinear)
            per_unit = 0.5 * n_a * (n_a if printed else 1)
            row, column = (x + 1.0) * per_unit, (y + 1.0) * per_unit
            _add(angle, 0, n_a, row, column, weight * _cosine(z + 1.0, flat, printed), bilinear)
            _add(angle, 1 + part, n_a, row, column, weight * _cosine(within + 1.0, flat, printed), bilinear)
        for part in range(N_PARTS):
            _store(spin[part], hssi[k, part])
            _store(count[part], vqai[k, part])
            _store(angle[part], vaai[k, part])


@njit(cache=True, nogil=True)
def _store(sums: NDArray[np.float64], image: NDArray[np.float32]) -> None:
    size = image.shape[0]
    for row in range(size):
        for column in range(size):
            image[row, column] = sums[row * size + column]
