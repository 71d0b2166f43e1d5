"""Software rendering of clouds: z-buffered splats with eye-dome lighting."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_column, check_positive, check_xyz
from mlsroad_pipeline.reporting.clouds.splat_kernels import NEAR, close, compose, darken, splat
from mlsroad_pipeline.reporting.clouds.view import View

_CHUNK = 1 << 20


def nearest_points(
    xyz: ArrayLike, view: View, *, splat_metres: float = 0.05, largest_splat: int = 7
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return the nearest point and its depth for each pixel of a view."""
    points = check_xyz(xyz)
    check_positive(splat_metres, "splat_metres")
    if largest_splat < 1:
        raise ParameterError(f"largest_splat must be at least 1 pixel, got {largest_splat}")
    width, height = view.size
    depth = np.full((height, width), np.inf, dtype=np.float32)
    winner = np.full((height, width), -1, dtype=np.int64)
    rotation = view.rotation.astype(np.float32)
    centre = view.centre.astype(points.dtype)
    for start in range(0, len(points), _CHUNK):
        # subtract the viewpoint before conversion to float32, to keep the millimetres of UTM coordinates
        near = (points[start : start + _CHUNK] - centre).astype(np.float32)
        splat(
            near, start, rotation, np.float32(view.scale), view.perspective, np.float32(splat_metres),
            largest_splat, depth, winner,
        )  # fmt: skip
    return winner, depth


def close_gaps(
    index: NDArray[np.int64], depth: NDArray[np.float32], *, reach: int = 4, step: float = 0.4
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Close small gaps between the points of one surface.

    Distant surfaces are sampled sparsely, and the background shows through. A pixel is a gap if three of the four pairs
    of opposite sectors around it contain nearer pixels.
    """
    if reach < 0:
        raise ParameterError(f"reach must be at least 0 pixels, got {reach}")
    check_positive(step, "step")
    closed_index, closed_depth = index.copy(), depth.copy()
    if reach:
        close(depth, index, _offsets(reach), reach, np.float32(step), closed_depth, closed_index)
    return closed_index, closed_depth


def _offsets(reach: int) -> NDArray[np.int64]:
    """Return the offsets of neighbouring pixels (down, right, sector of 45 degrees), closest first."""
    grid = np.arange(-reach, reach + 1)
    down, right = (side.ravel() for side in np.meshgrid(grid, grid, indexing="ij"))
    sector = np.rint(np.arctan2(down, right) / (np.pi / 4)).astype(np.int64) % 8
    order = np.argsort(down**2 + right**2, kind="stable")[1:]
    return np.stack([down, right, sector], axis=1)[order]


def depth_shading(depth: NDArray[np.float32], view: View, *, strength: float = 1.0) -> NDArray[np.float32]:
    """Return the brightness of each pixel under eye-dome lighting.

    Depth edges are darkened on their far side, which separates objects without normals or lights (Boucheny 2009,
    "Visualisation scientifique de grands volumes de données: pour une approche perceptive", chapter 4).
    """
    if not np.isfinite(strength) or strength < 0:
        raise ParameterError(f"strength must be a finite number >= 0, got {strength}")
    shade = np.ones(depth.shape, dtype=np.float32)
    seen = np.isfinite(depth)
    if view.perspective:
        flat = np.where(seen, np.log2(np.maximum(depth, np.float32(NEAR))), np.inf).astype(np.float32)
        gain = 12.0
    else:
        # orthographic depths: saturating scale, so that roofs stay legible
        flat = np.where(seen, np.log2(1 + 0.5 * np.maximum(depth, 0)), np.inf).astype(np.float32)
        gain = 1.6
    for radius, weight in ((1, 0.6), (3, 0.4)):
        darken(flat, radius, np.float32(gain * weight * strength), shade)
    return np.maximum(shade, np.float32(0.25))


def shaded_picture(
    index: NDArray[np.int64],
    shade: NDArray[np.float32],
    colours: NDArray[np.uint8],
    *,
    background: tuple[int, int, int] = (255, 255, 255),
    oversampling: int = 1,
) -> NDArray[np.uint8]:
    """Return the coloured and shaded picture, down-sampled by `oversampling`."""
    rows, columns = (side // oversampling for side in index.shape)
    picture = np.empty((rows, columns, 3), dtype=np.uint8)
    compose(index, shade, colours, np.asarray(background, dtype=np.float32), oversampling, picture)
    return picture


def render_points(
    xyz: ArrayLike,
    colours: ArrayLike,
    view: View,
    *,
    splat_metres: float = 0.05,
    largest_splat: int = 7,
    gap: int = 3,
    shading: float = 1.0,
    background: tuple[int, int, int] = (255, 255, 255),
    oversampling: int = 2,
) -> NDArray[np.uint8]:
    """Render coloured points.

    Examples
    --------
    >>> from mlsroad_pipeline.reporting.clouds.view import birds_eye_view
    >>> points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    >>> red = np.array([[255, 0, 0], [255, 0, 0]], dtype=np.uint8)
    >>> render_points(points, red, birds_eye_view(points, width=40, height=20)).shape
    (20, 40, 3)
    """
    points = check_xyz(xyz)
    paint = check_column(colours, len(points), "colours", 3)
    if paint.dtype != np.uint8:
        raise DataError(f"colours must be uint8, got {paint.dtype}")
    check_at_least(oversampling, 1, "oversampling")
    large = view.enlarged(oversampling)
    index, depth = nearest_points(points, large, splat_metres=splat_metres, largest_splat=largest_splat)
    index, depth = close_gaps(index, depth, reach=gap * oversampling)
    shade = depth_shading(depth, large, strength=shading)
    return shaded_picture(index, shade, paint, background=background, oversampling=oversampling)
