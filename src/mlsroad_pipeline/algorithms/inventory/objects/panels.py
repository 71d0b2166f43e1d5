"""Panels of traffic signs: plane, edges and facing."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.objects.axes import fit_axis
from mlsroad_pipeline.algorithms.inventory.objects.boxes import trimmed
from mlsroad_pipeline.algorithms.inventory.objects.plate_shapes import plate_shape

_TURN = 2.0  # step of the search over directions, degrees
_BIN = 0.02  # width of the bins along the normal, metres
_BAND = 0.04  # largest distance of points of a panel from its plane, metres
_ROW = 0.05  # height of the rows of a panel, metres
_LEAST_WIDTH = 0.12  # minimum width of a row of a panel; posts are narrower, metres
_GAP = 3  # largest gap within a panel or between panels on one post, rows
_LEAST_POINTS = 8
_LEAST_STANDOFF = 0.01  # minimum distance of the post from the plane for a known side, metres
_STRAY = 0.005  # share of points outside the left and right edge
_SHAPE_MARGIN = (0.03, 0.02)  # distances beside and above the rectangle of a panel of points of its shape, metres
_POST = 0.12  # largest distance of the post from the centre of the panel, metres


@dataclass(frozen=True)
class Panel:
    """Panel of a sign, or several above each other on one post."""

    centre: NDArray[np.float64]  # m, of the rectangle
    bottom: float  # m, elevation of the lower edge
    top: float  # m, elevation of the upper edge
    width: float  # m
    normal: float  # degrees clockwise from north: the facing, 0 to 360; below 180 if the side is unknown
    faces: bool  # True if the side is determined from the post behind the panel
    shape: str  # one of `PLATE_SHAPES`, or empty


def fit_panel(xyz: NDArray[np.float64]) -> Panel | None:
    """Fit the panel of a sign, with or without its post; None if no flat part is wider than 0.12 m.

    The vertical plane with most points away from the post is refined by least squares. The panel consists of its wide
    rows of 5 cm; its side follows from the post, whose axis must lie 1 to 12 cm behind it.
    """
    if len(xyz) < _LEAST_POINTS:
        return None
    centre = xyz.mean(axis=0)
    local = xyz - centre
    axis = fit_axis(local)
    away = np.hypot(*local[:, :2].T) if axis is None else axis.distance(local)
    weight = np.clip(away / 0.15, 0.05, 1.0)
    turn, offset = _plane(local, weight, np.radians(np.arange(0.0, 180.0, _TURN)))
    for _ in range(3):
        normal = np.array([np.cos(turn), np.sin(turn)])
        near = np.abs(local[:, :2] @ normal - offset) <= _BAND
        if near.sum() < _LEAST_POINTS:
            return None
        turn, offset = _refined(local[near, :2], weight[near] ** 2)
    normal = np.array([np.cos(turn), np.sin(turn)])
    near = np.abs(local[:, :2] @ normal - offset) <= _BAND
    rows = _panel_rows(local[near], np.array([-normal[1], normal[0]]))
    if rows is None:
        return None
    bottom, top, left, right = rows
    across = np.array([-normal[1], normal[0]])
    middle = np.array([*(offset * normal + (left + right) / 2 * across), (bottom + top) / 2])
    uv = np.column_stack([(local[near, :2] - middle[:2]) @ across, local[near, 2] - middle[2]])
    limits = np.array([right - left, top - bottom]) / 2 + _SHAPE_MARGIN
    side = _behind(local, middle, bottom, normal)
    if side > 0:
        normal = -normal
    azimuth = float(np.degrees(np.arctan2(normal[0], normal[1])) % 360.0)
    return Panel(
        middle + centre, bottom + centre[2], top + centre[2], right - left,
        azimuth if side != 0 else azimuth % 180.0, side != 0, plate_shape(uv[(np.abs(uv) <= limits).all(axis=1)]),
    )  # fmt: skip


@njit(cache=True)
def _plane(xyz: NDArray[np.float64], weight: NDArray[np.float64], turns: NDArray[np.float64]) -> tuple[float, float]:
    """Return direction and offset of the vertical plane with the largest weight within three bins."""
    best, turn, offset, along = -1.0, 0.0, 0.0, np.empty(len(xyz))
    for t in turns:
        c, s = np.cos(t), np.sin(t)
        low, high = np.inf, -np.inf
        for i in range(len(along)):
            along[i] = xyz[i, 0] * c + xyz[i, 1] * s
            low, high = min(low, along[i]), max(high, along[i])
        bins = np.zeros(int((high - low) / _BIN) + 3)
        for i in range(len(along)):
            bins[int((along[i] - low) / _BIN) + 1] += weight[i]
        for b in range(1, len(bins) - 1):
            total = bins[b - 1] + bins[b] + bins[b + 1]
            if total > best:
                best, turn, offset = total, t, low + (b - 0.5) * _BIN
    return turn, offset


def _refined(xy: NDArray[np.float64], weight: NDArray[np.float64]) -> tuple[float, float]:
    middle = weight @ xy / weight.sum()
    local = xy - middle
    normal = np.linalg.eigh((local * weight[:, None]).T @ local)[1][:, 0]
    return float(np.arctan2(normal[1], normal[0])), float(middle @ normal)


def _panel_rows(xyz: NDArray[np.float64], along: NDArray[np.float64]) -> tuple[float, float, float, float] | None:
    """Return lower, upper, left and right edge of the rows that are wider than a post."""
    u, z = xyz[:, :2] @ along, xyz[:, 2]
    row = np.floor((z - z.min()) / _ROW).astype(np.int64)
    n_rows = int(row.max()) + 1
    left, right = np.full(n_rows, np.inf), np.full(n_rows, -np.inf)
    np.minimum.at(left, row, u)
    np.maximum.at(right, row, u)
    width = right - left
    wide = np.flatnonzero(width > _LEAST_WIDTH)
    if not len(wide):
        return None
    groups = np.split(wide, np.flatnonzero(np.diff(wide) > _GAP + 1) + 1)
    group = max(groups, key=lambda rows: float(width[rows].sum()))
    last = int(group[-1])
    while last + 1 < n_rows and np.isfinite(width[last + 1 : last + 3]).any():
        last += 1  # the tip of a triangle is narrow; posts do not extend far above panels
    inside = (row >= group[0]) & (row <= last)
    edges = trimmed(u[inside], _STRAY)
    # The lowest row may contain part of the post below the panel.
    lowest = float(z[inside].min())
    beside = inside & (np.abs(u - (edges[0] + edges[1]) / 2) > _LEAST_WIDTH / 2)
    bottom = min(float(z[beside].min()), lowest + _ROW)
    return bottom, float(z[inside].max()), *edges


def _behind(xyz: NDArray[np.float64], middle: NDArray[np.float64], bottom: float, normal: NDArray[np.float64]) -> int:
    """Return the side of the post: 1 in the direction of the normal, -1 opposite, 0 unknown."""
    below = xyz[xyz[:, 2] < bottom - _ROW]
    axis = fit_axis(below) if len(below) else None
    if axis is None:
        return 0
    reach = axis.at(float(middle[2])) - middle[:2]
    standoff = float(reach @ normal)
    if abs(standoff) < _LEAST_STANDOFF or abs(standoff) > _POST:
        return 0
    return 1 if standoff > 0 else -1
