"""Kernels of `splatting`."""

import numpy as np
from numba import njit

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
