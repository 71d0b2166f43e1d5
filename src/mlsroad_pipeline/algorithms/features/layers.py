"""Features of the horizontal layers of an object."""

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.algorithms.features.accumulation_images import concatenate_objects

N_FEATURES = 10
"""Features per layer."""


def describe_layers(objects: Sequence[ArrayLike], *, n_layers: int = 10) -> NDArray[np.float32]:
    """Compute features of layers of equal height of objects."""
    check_at_least(n_layers, 1, "n_layers")
    xyz, indptr = concatenate_objects(objects)
    out = np.zeros((len(objects), n_layers, N_FEATURES))
    _describe(xyz, indptr, out)
    return out.reshape(len(objects), -1).astype(np.float32)


@njit(cache=True, nogil=True)
def _sum_layers(
    dx: NDArray[np.float64],
    dy: NDArray[np.float64],
    elevation: NDArray[np.float64],
    sums: NDArray[np.float64],
    greatest: NDArray[np.float64],
) -> None:
    """Write the sums of each layer of an object and its greatest distance from the axis, from offsets to the centre."""
    angle = 0.5 * np.arctan2(2.0 * (dx * dy).sum(), (dx * dx).sum() - (dy * dy).sum())
    ux, uy = np.cos(angle), np.sin(angle)
    low, height, n_layers = elevation.min(), elevation.max() - elevation.min(), len(sums)
    sums[:] = 0.0
    sums[:, 8], sums[:, 10] = np.inf, np.inf
    sums[:, 9], sums[:, 11] = -np.inf, -np.inf
    for i in range(len(dx)):
        a, b, z = dx[i] * ux + dy[i] * uy, dy[i] * ux - dx[i] * uy, elevation[i] - low
        layer = min(int(z / height * n_layers), n_layers - 1) if height > 0.0 else 0
        r = np.sqrt(a * a + b * b)
        s = sums[layer]
        s[0] += 1.0
        s[1] += a
        s[2] += b
        s[3] += z
        s[4] += r
        s[5] += a * a
        s[6] += b * b
        s[7] += z * z
        s[8], s[9] = min(s[8], a), max(s[9], a)
        s[10], s[11] = min(s[10], b), max(s[11], b)
        greatest[layer] = max(greatest[layer], r)


@njit(cache=True, nogil=True)
def _describe(xyz: NDArray[np.float64], indptr: NDArray[np.int64], out: NDArray[np.float64]) -> None:
    n_layers = out.shape[1]
    sums = np.empty((n_layers, 12))  # count, sums of a, b, z, r, squares of a, b, z, then extremes of a and b
    for k in range(len(out)):
        part = xyz[indptr[k] : indptr[k + 1]]
        n = len(part)
        base = part[0].copy()  # sums relative to a point of the object preserve precision
        mx, my = (part[:, 0] - base[0]).mean(), (part[:, 1] - base[1]).mean()
        dx, dy = part[:, 0] - base[0] - mx, part[:, 1] - base[1] - my
        greatest = np.zeros(n_layers)
        _sum_layers(dx, dy, part[:, 2], sums, greatest)
        for layer in range(n_layers):
            s, o = sums[layer], out[k, layer]
            c = s[0]
            if c == 0.0:
                continue
            o[0] = c / n
            o[1], o[2] = s[9] - s[8], s[11] - s[10]
            o[3] = np.sqrt(max(s[5] / c - (s[1] / c) ** 2, 0.0))
            o[4] = np.sqrt(max(s[6] / c - (s[2] / c) ** 2, 0.0))
            o[5], o[6] = abs(s[1] / c), abs(s[2] / c)
            o[7], o[8] = s[4] / c, greatest[layer]
            o[9] = np.sqrt(max(s[7] / c - (s[3] / c) ** 2, 0.0))
