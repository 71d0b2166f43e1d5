"""Brown-Conrady lens distortion and its inverse."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

_STEPS = 40
_MARGIN = 1.04  # the lens model is used slightly beyond the image corners


@njit(cache=True, nogil=True)
def distort_one(x: float, y: float, d: NDArray[np.float64]) -> tuple[float, float]:
    """Distort a point of the ideal image plane; see `distort`."""
    squared = x * x + y * y
    radial = 1.0 + squared * (d[0] + squared * (d[1] + squared * d[4]))
    return (
        x * radial + 2 * d[2] * x * y + d[3] * (squared + 2 * x * x),
        y * radial + d[2] * (squared + 2 * y * y) + 2 * d[3] * x * y,
    )


@njit(cache=True, nogil=True)
def undistort_one(u: float, v: float, d: NDArray[np.float64]) -> tuple[float, float]:
    """Undistort a point of the image plane; see `undistort`."""
    x, y = u, v
    for _ in range(_STEPS):
        squared = x * x + y * y
        radial = 1.0 + squared * (d[0] + squared * (d[1] + squared * d[4]))
        aside = 2 * d[2] * x * y + d[3] * (squared + 2 * x * x)
        below = d[2] * (squared + 2 * y * y) + 2 * d[3] * x * y
        nx, ny = (u - aside) / radial, (v - below) / radial
        moved = abs(nx - x) + abs(ny - y)
        x, y = nx, ny
        if moved < 1e-14:
            break
    return x, y


def distort(plane: NDArray[np.float64], distortion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Apply lens distortion to points of the ideal image plane."""
    return _each(np.ascontiguousarray(plane, dtype=np.float64), np.asarray(distortion, dtype=np.float64), False)


def undistort(plane: NDArray[np.float64], distortion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Remove lens distortion from points of the image plane, the inverse of `distort`."""
    return _each(np.ascontiguousarray(plane, dtype=np.float64), np.asarray(distortion, dtype=np.float64), True)


@njit(cache=True, nogil=True)
def _each(plane: NDArray[np.float64], distortion: NDArray[np.float64], inverse: bool) -> NDArray[np.float64]:
    out = np.empty_like(plane)
    for i in range(len(plane)):
        if inverse:
            out[i, 0], out[i, 1] = undistort_one(plane[i, 0], plane[i, 1], distortion)
        else:
            out[i, 0], out[i, 1] = distort_one(plane[i, 0], plane[i, 1], distortion)
    return out


def trusted_radius(k: NDArray[np.float64], distortion: NDArray[np.float64], width: int, height: int) -> float:
    """Return the squared radius in the ideal plane beyond which points are outside the image."""
    u, v = np.meshgrid([-0.5, width - 0.5], [-0.5, height - 0.5])
    corners = np.column_stack([(u.ravel() - k[0, 2]) / k[0, 0], (v.ravel() - k[1, 2]) / k[1, 1]])
    return float(_MARGIN * (undistort(corners, distortion) ** 2).sum(axis=1).max())


def fold_radius(distortion: NDArray[np.float64]) -> float:
    """Return the radius in the ideal plane up to which the radial distortion is monotonic."""
    roots = np.roots([7 * distortion[4], 5 * distortion[1], 3 * distortion[0], 1.0])
    squares = roots.real[(np.abs(roots.imag) < 1e-9 * np.maximum(np.abs(roots.real), 1e-300)) & (roots.real > 0)]
    return float(np.sqrt(squares.min())) if len(squares) else float("inf")
