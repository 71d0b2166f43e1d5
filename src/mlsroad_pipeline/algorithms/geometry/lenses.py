"""Lens distortion after Brown and Conrady, both ways."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_STEPS = 40
_MARGIN = 1.04  # a lens is trusted this little beyond its corners


@njit(cache=True, nogil=True)
def distort_one(x: float, y: float, d: NDArray[np.float64]) -> tuple[float, float]:
    """Return where a place of the ideal image plane lies behind a lens; see `distort`."""
    squared = x * x + y * y
    radial = 1.0 + squared * (d[0] + squared * (d[1] + squared * d[4]))
    return (
        x * radial + 2 * d[2] * x * y + d[3] * (squared + 2 * x * x),
        y * radial + d[2] * (squared + 2 * y * y) + 2 * d[3] * x * y,
    )


@njit(cache=True, nogil=True)
def undistort_one(u: float, v: float, d: NDArray[np.float64]) -> tuple[float, float]:
    """Return the place of the ideal image plane that a lens puts at another; see `undistort`."""
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
    """Return where places of the ideal image plane lie behind a lens.

    Parameters
    ----------
    plane : ndarray of shape (n, 2), float64
        x / z and y / z in the camera's frame.
    distortion : ndarray of shape (5,), float64
        k1, k2, p1, p2, k3, in OpenCV's order: with r^2 = x^2 + y^2 and f = 1 + k1 r^2 + k2 r^4 + k3 r^6, x becomes
        x f + 2 p1 x y + p2 (r^2 + 2 x^2) and y becomes y f + p1 (r^2 + 2 y^2) + 2 p2 x y.

    Returns
    -------
    ndarray of shape (n, 2), float64
        Distorted places; K makes pixels of them.

    References
    ----------
    .. [1] D. C. Brown, "Decentering distortion of lenses", Photogrammetric Engineering 32(3), 1966.
    """
    return _each(np.ascontiguousarray(plane, dtype=np.float64), np.asarray(distortion, dtype=np.float64), False)


def undistort(plane: NDArray[np.float64], distortion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the places of the ideal image plane that a lens puts at given ones: the inverse of `distort`.

    Parameters
    ----------
    plane : ndarray of shape (n, 2), float64
        Distorted places, within the image.
    distortion : ndarray of shape (5,), float64
        As for `distort`.

    Returns
    -------
    ndarray of shape (n, 2), float64
        x / z and y / z, by fixed-point iteration.
    """
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
    """Return the squared radius in the ideal plane beyond which nothing is in the image, whatever `distort` says.

    Parameters
    ----------
    k : ndarray of shape (3, 3), float64
        Calibration matrix, pixels.
    distortion : ndarray of shape (5,), float64
        As for `distort`.
    width, height : int
        Size of the image, pixels.

    Returns
    -------
    float
        That of the farthest corner and a margin; polynomials of a lens turn back somewhere beyond.
    """
    u, v = np.meshgrid([-0.5, width - 0.5], [-0.5, height - 0.5])
    corners = np.column_stack([(u.ravel() - k[0, 2]) / k[0, 0], (v.ravel() - k[1, 2]) / k[1, 1]])
    return float(_MARGIN * (undistort(corners, distortion) ** 2).sum(axis=1).max())


def fold_radius(distortion: NDArray[np.float64]) -> float:
    """Return the radius in the ideal plane up to which a lens keeps the order of places along a ray from its centre.

    Parameters
    ----------
    distortion : ndarray of shape (5,), float64
        As for `distort`.

    Returns
    -------
    float
        The least r > 0 at which d/dr (r + k1 r^3 + k2 r^5 + k3 r^7) is 0; beyond it the polynomial puts places back
        into the image that are not in it. Infinite where there is none.
    """
    roots = np.roots([7 * distortion[4], 5 * distortion[1], 3 * distortion[0], 1.0])
    squares = roots.real[(np.abs(roots.imag) < 1e-9 * np.maximum(np.abs(roots.real), 1e-300)) & (roots.real > 0)]
    return float(np.sqrt(squares.min())) if len(squares) else float("inf")
