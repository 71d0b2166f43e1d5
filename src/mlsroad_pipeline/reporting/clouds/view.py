"""Views of a cloud: projection of points to pixels and depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.validation import check_xyz

_SAMPLE = 100_000
_CHUNK = 1 << 20
_MARGIN = 1.04


@dataclass(frozen=True)
class View:
    """Projection p_view = rotation (p - centre), x to the right, y down, z away from the viewer."""

    # World to view; rows are the right and down axes of the picture and the viewing direction
    rotation: NDArray[np.float64]
    # The viewpoint, metres; for orthographic views the point at the centre of the picture, at depth 0
    centre: NDArray[np.float64]
    scale: float  # Orthographic: pixels per metre. Perspective: the focal length in pixels.
    size: tuple[int, int]  # Width and height of the picture, pixels
    perspective: bool  # Perspective projection; False is orthographic

    def enlarged(self, factor: int) -> View:
        """Return the same view with more pixels."""
        width, height = self.size
        return View(
            self.rotation, self.centre, self.scale * factor, (width * factor, height * factor), self.perspective
        )


def _sample(xyz: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return evenly spaced rows, enough to estimate extents."""
    return xyz[:: max(1, len(xyz) // _SAMPLE)].astype(np.float64)


def main_azimuth(xyz: ArrayLike) -> float:
    """Return the horizontal direction of largest variance."""
    points = _sample(check_xyz(xyz, minimum=1))[:, :2]
    covariance = np.cov(points.T, bias=True)
    values, vectors = np.linalg.eigh(covariance)
    if values[1] - values[0] <= 1e-9 * max(values[1], 1e-300):
        return 0.0
    angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    return (angle + 90.0) % 180.0 - 90.0


def _extent(
    points: NDArray[np.floating], middle: NDArray[np.float64], axes: NDArray[np.float64], trim: float
) -> NDArray[np.float64]:
    """Return the trimmed minimum and maximum along two axes."""
    if trim:
        return np.quantile((_sample(points) - middle) @ axes.T, [trim, 1 - trim], axis=0)
    limits = np.array([[np.inf, np.inf], [-np.inf, -np.inf]])
    for start in range(0, len(points), _CHUNK):
        across = (points[start : start + _CHUNK] - middle) @ axes.T
        limits[0] = np.minimum(limits[0], across.min(axis=0))
        limits[1] = np.maximum(limits[1], across.max(axis=0))
    return limits


def birds_eye_view(
    xyz: ArrayLike, *, width: int = 1600, height: int | None = None, azimuth: float | None = None, trim: float = 0.0
) -> View:
    """Return an orthographic view of a whole cloud from above."""
    points = check_xyz(xyz, minimum=1)
    turn = np.radians(main_azimuth(points) if azimuth is None else azimuth)
    right = np.array([np.cos(turn), np.sin(turn), 0.0])
    down = np.array([np.sin(turn), -np.cos(turn), 0.0])
    rotation = np.stack([right, down, np.array([0.0, 0.0, -1.0])])
    middle = (points.min(axis=0).astype(np.float64) + points.max(axis=0)) / 2
    least, most = _extent(points, middle, rotation[:2], trim)
    extent = np.maximum(most - least, 1e-3) * _MARGIN
    rows = height if height is not None else round(float(np.clip(width * extent[1] / extent[0], width / 4, width)))
    centre = middle + ((least + most) / 2) @ rotation[:2]
    centre[2] = float(points[:, 2].max())
    return View(rotation, centre, float(min(width / extent[0], rows / extent[1])), (width, rows), False)


def look_at(
    eye: ArrayLike, target: ArrayLike, *, size: tuple[int, int] = (1600, 900), field_of_view: float = 50.0
) -> View:
    """Return a perspective view from one point to another, with the vertical upwards."""
    place, aim = np.asarray(eye, dtype=np.float64), np.asarray(target, dtype=np.float64)
    forward = (aim - place) / np.linalg.norm(aim - place)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    # vertical views have no horizon: x is the right axis
    right = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(right) < 1e-9 else right / np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return View(rotation, place, size[0] / 2 / float(np.tan(np.radians(field_of_view) / 2)), size, True)


def oblique_view(
    xyz: ArrayLike,
    *,
    size: tuple[int, int] = (1600, 900),
    azimuth: float | None = None,
    elevation: float = 32.0,
    length: float = 70.0,
    field_of_view: float = 50.0,
) -> View:
    """Return an oblique perspective view of a stretch of the street."""
    points = _sample(check_xyz(xyz, minimum=1))
    turn = np.radians(main_azimuth(points) + 35.0 if azimuth is None else azimuth)
    rise = np.radians(elevation)
    forward = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), -np.sin(rise)])
    target = np.median(points, axis=0)
    near = points[np.linalg.norm(points[:, :2] - target[:2], axis=1) <= length / 2]
    if len(near):
        target[2] = np.quantile(near[:, 2], 0.3)
    distance = 0.5 * length / float(np.tan(np.radians(field_of_view) / 2))
    return look_at(target - forward * distance, target, size=size, field_of_view=field_of_view)


def scale_length(metres: float) -> float:
    """Return the largest of 1, 2 or 5 times a power of ten that is at most `metres`.

    Examples
    --------
    >>> scale_length(37.0), scale_length(1.0)
    (20.0, 1.0)
    """
    power = 10.0 ** np.floor(np.log10(metres))
    return float(max(step * power for step in (1, 2, 5) if step * power <= metres * (1 + 1e-9)))
