"""Shape of a sign's plate: the outline of the smallest area that encloses its points."""

import numpy as np
from numpy.typing import NDArray

PLATE_SHAPES = ("round", "triangle", "rectangle")
"""Shapes of plates; octagons are round, and squares on their tip are rectangles."""

_LEAST_POINTS, _LEAST_SIDE = 20, 0.15  # fewer points or metres have no shape
_RECTANGLE, _TIP = 1.08, 1.05  # factors of areas, for the freedom of two sides and of a side turned by 45 degrees
_CLEAR = 1.05  # least ratio of the second smallest area to the smallest
_STEPS = 60  # of the search for the enclosing circle


def plate_shape(uv: NDArray[np.float64]) -> str:
    """Return the shape of a plate from its points in its plane, to the right and upwards; empty where it is not clear.

    The likelihood of evenly spread points is the larger, the smaller the area that encloses them.
    """
    if len(uv) < _LEAST_POINTS or float(np.ptp(uv, axis=0).min()) < _LEAST_SIDE:
        return ""
    reach = _supports(uv)
    tip = max(reach[45] + reach[225], reach[135] + reach[315])
    triangle = min(reach[30] + reach[150] + reach[270], reach[90] + reach[210] + reach[330])
    areas = {
        "round": np.pi * _radius(uv) ** 2,
        "triangle": triangle**2 / np.sqrt(3.0),
        "rectangle": min(_RECTANGLE * (reach[0] + reach[180]) * (reach[90] + reach[270]), _TIP * tip**2),
    }
    best, second = sorted(areas, key=lambda name: float(areas[name]))[:2]
    return best if areas[second] >= _CLEAR * areas[best] else ""


def _supports(uv: NDArray[np.float64]) -> dict[int, float]:
    """Return how far the points reach in directions, counter-clockwise from the right, degrees."""
    degrees = np.array([0, 30, 45, 90, 135, 150, 180, 210, 225, 270, 315, 330])
    way = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    return dict(zip(degrees.tolist(), (uv @ way).max(axis=0).tolist(), strict=True))


def _radius(uv: NDArray[np.float64]) -> float:
    """Return the radius of the smallest enclosing circle (Badoiu and Clarkson 2003)."""
    centre = (uv.min(axis=0) + uv.max(axis=0)) / 2
    for k in range(_STEPS):
        centre = centre + (uv[np.argmax(np.hypot(*(uv - centre).T))] - centre) / (k + 2)
    return float(np.hypot(*(uv - centre).T).max())
