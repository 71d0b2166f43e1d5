"""Colours of points, taken from the images with the errors at edges that real systems have."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.lenses import distort_one, trusted_radius
from mlsroad_pipeline.simulation.cameras.cameras import Image

_TRIES = 24  # images tested for one point's colour
_DEPTH_SLACK = 0.06  # metres, and 1 % of the depth


def colour_points(
    xyz: NDArray[np.float64], times: NDArray[np.float64], images: list[Image], depths: list[NDArray[np.float32]]
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the colours of points from the temporally nearest image that shows them, and which points have one.

    `xyz` is (n, 3), world minus origin, metres; `times` are GPS seconds. Images are in the order of time, each with its
    depth image in metres. Colours are uint8, black for points in no image.
    """
    if not images:
        return np.zeros((len(xyz), 3), dtype=np.uint8), np.zeros(len(xyz), dtype=np.bool_)
    return _colour_points(
        xyz, times, np.array([i.time for i in images]), np.stack([i.rgb for i in images]), np.stack(depths),
        np.stack([i.R for i in images]), np.stack([i.t for i in images]), np.stack([i.K for i in images]),
        np.stack([i.distortion for i in images]),
        np.array([trusted_radius(i.K, i.distortion, i.width, i.height) for i in images]),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _colour_points(
    xyz: NDArray[np.float64], times: NDArray[np.float64], taken: NDArray[np.float64], rgb: NDArray[np.uint8],
    depth: NDArray[np.float32], rotations: NDArray[np.float64], translations: NDArray[np.float64],
    calibrations: NDArray[np.float64], lenses: NDArray[np.float64], trusted: NDArray[np.float64],
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:  # fmt: skip
    n, m = len(xyz), len(taken)
    height, width = depth.shape[1:]
    colours, seen = np.zeros((n, 3), dtype=np.uint8), np.zeros(n, dtype=np.bool_)
    for i in range(n):
        after = np.searchsorted(taken, times[i])
        before = after - 1
        for _ in range(_TRIES):
            if before < 0 and after >= m:
                break
            if after >= m or (before >= 0 and times[i] - taken[before] <= taken[after] - times[i]):
                j = before
                before -= 1
            else:
                j = after
                after += 1
            r, t, k = rotations[j], translations[j], calibrations[j]
            z = r[2, 0] * xyz[i, 0] + r[2, 1] * xyz[i, 1] + r[2, 2] * xyz[i, 2] + t[2]
            if z < 0.3:
                continue
            x = r[0, 0] * xyz[i, 0] + r[0, 1] * xyz[i, 1] + r[0, 2] * xyz[i, 2] + t[0]
            y = r[1, 0] * xyz[i, 0] + r[1, 1] * xyz[i, 1] + r[1, 2] * xyz[i, 2] + t[1]
            x, y = x / z, y / z
            if x * x + y * y > trusted[j]:
                continue
            x, y = distort_one(x, y, lenses[j])
            u, v = int(np.floor(k[0, 0] * x + k[0, 2] + 0.5)), int(np.floor(k[1, 1] * y + k[1, 2] + 0.5))
            if u < 0 or v < 0 or u >= width or v >= height or z > depth[j, v, u] * 1.01 + _DEPTH_SLACK:
                continue
            colours[i] = rgb[j, v, u]
            seen[i] = True
            break
    return colours, seen


@njit(cache=True, nogil=True)
def spread_colours(
    xyz: NDArray[np.float64], scanner: NDArray[np.uint8], rgb: NDArray[np.uint8], seen: NDArray[np.bool_], reach: float
) -> NDArray[np.uint8]:
    """Colour the remaining points like the nearer of the previous and the next coloured point of their scanner.

    Points are in the order of time; `reach` is the largest distance in metres, beyond which points stay black.
    """
    n = len(xyz)
    out = rgb.copy()
    best = np.full(n, reach * reach)
    for backwards in range(2):
        last = np.full(256, -1, dtype=np.int64)
        for step in range(n):
            i = n - 1 - step if backwards else step
            if seen[i]:
                last[scanner[i]] = i
                continue
            j = last[scanner[i]]
            if j < 0:
                continue
            apart = (xyz[i, 0] - xyz[j, 0]) ** 2 + (xyz[i, 1] - xyz[j, 1]) ** 2 + (xyz[i, 2] - xyz[j, 2]) ** 2
            if apart < best[i]:
                best[i] = apart
                out[i] = rgb[j]
    return out
