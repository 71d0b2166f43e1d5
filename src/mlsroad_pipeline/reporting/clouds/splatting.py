"""Software rendering of clouds: z-buffered splats with eye-dome lighting."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.validation import check_column, check_xyz
from mlsroad_pipeline.reporting.clouds.view import View

NEAR = 0.1
"""Near clipping distance, metres."""


@njit(cache=True, nogil=True, error_model="numpy")
def splat(xyz, first, rotation, scale, perspective, splat_metres, largest, depth, winner):  # type: ignore[no-untyped-def]  # numba infers the types
    """Draw square splats into a depth buffer; ties go to the first point."""
    height, width = depth.shape
    for i in range(xyz.shape[0]):
        x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
        far = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z
        zoom = scale
        if perspective:
            if far < NEAR:
                continue
            zoom = scale / far
        u = (rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z) * zoom + width * np.float32(0.5)
        v = (rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z) * zoom + height * np.float32(0.5)
        side = min(max(int(splat_metres * zoom + np.float32(0.5)), 1), largest)
        reach = (side - 1) * np.float32(0.5)
        if not (u - reach > -side and v - reach > -side and u - reach < width and v - reach < height):
            continue
        left, top = int(np.floor(u - reach)), int(np.floor(v - reach))
        for row in range(max(top, 0), min(top + side, height)):
            for column in range(max(left, 0), min(left + side, width)):
                if far < depth[row, column]:
                    depth[row, column] = far
                    winner[row, column] = first + i


@njit(cache=True, nogil=True, error_model="numpy")
def window_minima(depth, reach):  # type: ignore[no-untyped-def]  # numba infers the types
    """Return the minimum depth over the rows, and over the columns, within a reach of each pixel."""
    height, width = depth.shape
    over_rows, over_columns = depth.copy(), depth.copy()
    for shift in range(1, reach + 1):
        for row in range(height):
            for other in (row - shift, row + shift):
                if 0 <= other < height:
                    for column in range(width):
                        over_rows[row, column] = min(over_rows[row, column], depth[other, column])
            for column in range(width - shift):
                over_columns[row, column] = min(over_columns[row, column], depth[row, column + shift])
            for column in range(shift, width):
                over_columns[row, column] = min(over_columns[row, column], depth[row, column - shift])
    return over_rows, over_columns


@njit(cache=True, nogil=True, error_model="numpy")
def is_surrounded(over_rows, over_columns, row, column, reach, limit):  # type: ignore[no-untyped-def]  # numba infers the types
    """Return whether nearer pixels lie on all four sides; without them no three pairs of opposite sectors have any."""
    height, width = over_rows.shape
    for low, high in ((max(column - reach, 0), column), (column + 1, min(column + reach + 1, width))):
        x = low
        while x < high and not over_rows[row, x] < limit:
            x += 1
        if x == high:
            return False
    for low, high in ((max(row - reach, 0), row), (row + 1, min(row + reach + 1, height))):
        y = low
        while y < high and not over_columns[y, column] < limit:
            y += 1
        if y == high:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def close(depth, winner, around, reach, step, closed_depth, closed_winner):  # type: ignore[no-untyped-def]  # numba infers the types
    """Fill gaps with the nearest surface around them: a pixel is in a gap if three of the four pairs of opposite
    sectors contain nearer pixels. `around` lists offsets (down, right, sector), closest first.
    """
    height, width = depth.shape
    over_rows, over_columns = window_minima(depth, reach)
    for row in range(height):
        for column in range(width):
            limit = depth[row, column] - step
            if not is_surrounded(over_rows, over_columns, row, column, reach, limit):
                continue
            sectors, best = 0, -1
            for k in range(around.shape[0]):
                y, x = row + around[k, 0], column + around[k, 1]
                if 0 <= y < height and 0 <= x < width and depth[y, x] < limit:
                    best = k if best < 0 else best
                    sectors |= 1 << around[k, 2]
                    if sectors == 255:
                        break
            pairs = 0
            for sector in range(4):
                pairs += (sectors >> sector) & (sectors >> (sector + 4)) & 1
            if pairs >= 3:
                y, x = row + around[best, 0], column + around[best, 1]
                closed_depth[row, column] = depth[y, x]
                closed_winner[row, column] = winner[y, x]


@njit(cache=True, nogil=True, error_model="numpy")
def darken(log_depth, radius, strength, shade):  # type: ignore[no-untyped-def]  # numba infers the types
    """Multiply `shade` by eye-dome lighting: pixels darken with the depth by which neighbours are in front."""
    height, width = log_depth.shape
    for row in range(height):
        for column in range(width):
            own = log_depth[row, column]
            if not np.isfinite(own):
                continue
            covered = np.float32(0)
            for down in range(-1, 2):
                for right in range(-1, 2):
                    y, x = row + down * radius, column + right * radius
                    if (down != 0 or right != 0) and 0 <= y < height and 0 <= x < width:
                        # empty neighbours are infinitely far and do not occlude
                        covered += max(np.float32(0), own - log_depth[y, x])
            shade[row, column] *= np.exp(-strength * covered * np.float32(0.125))


@njit(cache=True, nogil=True)
def compose(index, shade, colours, background, factor, picture):  # type: ignore[no-untyped-def]  # numba infers the types
    """Average blocks of `factor` x `factor` shaded pixels into one pixel."""
    height, width, _ = picture.shape
    share = np.float32(1.0 / (factor * factor))
    for row in range(height):
        for column in range(width):
            for channel in range(3):
                total = np.float32(0)
                for y in range(row * factor, (row + 1) * factor):
                    for x in range(column * factor, (column + 1) * factor):
                        point = index[y, x]
                        if point < 0:
                            total += background[channel]
                        else:
                            total += shade[y, x] * np.float32(colours[point, channel])
                picture[row, column, channel] = np.uint8(total * share + np.float32(0.5))


_CHUNK = 1 << 20
_PAPER = np.full(3, 255, np.float32)
_STEP = np.float32(0.4)  # depth by which the background of a gap is farther than its surroundings, metres


def nearest_points(
    xyz: ArrayLike, view: View, *, splat_metres: float = 0.05, largest_splat: int = 7
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return the nearest point and its depth for each pixel of a view."""
    points = check_xyz(xyz)
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
    index: NDArray[np.int64], depth: NDArray[np.float32], *, reach: int = 4
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Close small gaps between the points of one surface.

    Distant surfaces are sampled sparsely, and the background shows through. A pixel is a gap if three of the four pairs
    of opposite sectors around it contain nearer pixels.
    """
    closed_index, closed_depth = index.copy(), depth.copy()
    if reach:
        close(depth, index, _offsets(reach), reach, _STEP, closed_depth, closed_index)
    return closed_index, closed_depth


def _offsets(reach: int) -> NDArray[np.int64]:
    """Return the offsets of neighbouring pixels (down, right, sector of 45 degrees), closest first."""
    grid = np.arange(-reach, reach + 1)
    down, right = (side.ravel() for side in np.meshgrid(grid, grid, indexing="ij"))
    sector = np.rint(np.arctan2(down, right) / (np.pi / 4)).astype(np.int64) % 8
    order = np.argsort(down**2 + right**2, kind="stable")[1:]
    return np.stack([down, right, sector], axis=1)[order]


def depth_shading(depth: NDArray[np.float32], view: View) -> NDArray[np.float32]:
    """Return the brightness of each pixel under eye-dome lighting.

    Depth edges are darkened on their far side, which separates objects without normals or lights (Boucheny 2009,
    "Visualisation scientifique de grands volumes de données: pour une approche perceptive", chapter 4).
    """
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
        darken(flat, radius, np.float32(gain * weight), shade)
    return np.maximum(shade, np.float32(0.25))


def shaded_picture(
    index: NDArray[np.int64],
    shade: NDArray[np.float32],
    colours: NDArray[np.uint8],
    *,
    oversampling: int = 1,
) -> NDArray[np.uint8]:
    """Return the coloured and shaded picture, down-sampled by `oversampling`."""
    rows, columns = (side // oversampling for side in index.shape)
    picture = np.empty((rows, columns, 3), dtype=np.uint8)
    compose(index, shade, colours, _PAPER, oversampling, picture)
    return picture


def render_points(
    xyz: ArrayLike,
    colours: ArrayLike,
    view: View,
    *,
    splat_metres: float = 0.05,
    gap: int = 3,
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
    large = view.enlarged(oversampling)
    index, depth = nearest_points(points, large, splat_metres=splat_metres)
    index, depth = close_gaps(index, depth, reach=gap * oversampling)
    shade = depth_shading(depth, large)
    return shaded_picture(index, shade, paint, oversampling=oversampling)
