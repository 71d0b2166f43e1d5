"""Measures of one object of the road inventory, from the mean points of its voxels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

_SLICE = 0.25  # height of the slices whose medians an axis is fitted to, metres
_AXIS_BAND = 0.08  # how far a slice's median may lie from the axis of a pole, metres
_STRAY_SHARE, _STRAY_POINTS = (
    0.01,
    10.0,
)  # how many points may lie below the bottom: a share, and never more than so many
_FOOT = 1.0  # height of an object's foot, metres: where it meets the ground, and where a trunk stands


@dataclass(frozen=True)
class Voxels:
    """Mean points of an object's voxels.

    Parameters
    ----------
    xyz : ndarray of float64, shape (k, 3)
        Mean point per voxel, world coordinates, metres.
    z_low, z_high : ndarray of float64, shape (k,)
        Lowest and highest point per voxel, metres.
    ground : ndarray of float64, shape (k,)
        Mean elevation of the ground below, metres; NaN where it is not known.
    count : ndarray of int64, shape (k,)
        Points per voxel.
    confidence : ndarray of float64, shape (k,)
        Sum of the points' confidences.
    scene : ndarray of int32, shape (k,)
        Which scene's core the points are in.
    """

    xyz: NDArray[np.float64]
    z_low: NDArray[np.float64]
    z_high: NDArray[np.float64]
    ground: NDArray[np.float64]
    count: NDArray[np.int64]
    confidence: NDArray[np.float64]
    scene: NDArray[np.int32]

    def select(self, index: NDArray) -> Voxels:
        """Return the voxels at an index array or under a mask."""
        return Voxels(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def oriented_box(xy: NDArray[np.float64]) -> tuple[NDArray[np.float64], float, float, float]:
    """Find the rectangle of least area around points in plan, to a twentieth of a degree.

    Parameters
    ----------
    xy : ndarray of float64, shape (k, 2)
        Points, metres; at least one.

    Returns
    -------
    centre : ndarray of float64, shape (2,)
        Centre of the rectangle.
    length, width : float
        Its longer and its shorter side, metres.
    azimuth : float
        Direction of the longer side, degrees clockwise from north, 0 to 180.
    """
    middle = xy.mean(axis=0)
    moved = xy - middle

    def extents(degrees: NDArray[np.float64]) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        along, across = moved @ np.stack([c, s]), moved @ np.stack([-s, c])
        return along.min(axis=0), along.max(axis=0), across.min(axis=0), across.max(axis=0)

    angle = 0.0
    for steps in (np.arange(0.0, 90.0, 1.0), np.arange(-1.0, 1.01, 0.05)):
        a0, a1, b0, b1 = extents(angle + steps)
        # A line has no area at its own direction only: the perimeter decides among equally thin ones.
        angle += float(steps[np.argmin((a1 - a0) * (b1 - b0) + 1e-6 * ((a1 - a0) + (b1 - b0)))])
    box = extents(np.array([angle]))
    left, right, back, front = (float(value[0]) for value in box)
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    centre = middle + (left + right) / 2 * np.array([c, s]) + (back + front) / 2 * np.array([-s, c])
    first, second = right - left, front - back
    direction = angle if first >= second else angle + 90.0
    return centre, max(first, second), min(first, second), (90.0 - direction) % 180.0


def fit_axis(xyz: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Fit the axis of a pole, blind to arms, signs and lamps on it.

    The medians of slices of 0.25 m are taken; of all lines through two of them the one that passes within 0.08 m of
    most is refined by least squares on those that it passes.

    Parameters
    ----------
    xyz : ndarray of float64, shape (k, 3)
        Points, metres.

    Returns
    -------
    foot, slope : ndarray of float64, shape (2,)
        x and y of the axis at z = 0, and their change per metre of z; None with fewer than three slices.
    """
    number = np.floor((xyz[:, 2] - xyz[:, 2].min()) / _SLICE).astype(np.int64)
    order = np.argsort(number, kind="stable")
    parts = np.split(xyz[order], np.flatnonzero(np.diff(number[order])) + 1)
    if len(parts) < 3:
        return None
    medians = np.array([np.median(part, axis=0) for part in parts])
    centre = medians.mean(axis=0)
    local = medians - centre
    a, b = np.triu_indices(len(local), k=1)
    slope = (local[b, :2] - local[a, :2]) / (local[b, 2] - local[a, 2])[:, None]
    start = local[a, :2] - slope * local[a, 2:]
    away = np.hypot(*(start[:, :, None] + slope[:, :, None] * local[:, 2] - local[:, :2].T).transpose(1, 0, 2))
    near = away <= _AXIS_BAND
    best = int(np.lexsort((np.where(near, away, 0).sum(axis=1), -near.sum(axis=1)))[0])
    chosen = local[near[best]]
    design = np.column_stack([np.ones(len(chosen)), chosen[:, 2]])
    (fit_start, fit_slope), *_ = np.linalg.lstsq(design, chosen[:, :2], rcond=None)
    return fit_start + centre[:2] - fit_slope * centre[2], fit_slope


def measure(voxels: Voxels, kind: str) -> dict[str, float | int]:
    """Measure an object.

    Parameters
    ----------
    voxels : Voxels
        The object; at least one voxel.
    kind : str
        ``pole``, ``sign``, ``vehicle`` or ``tree``.

    Returns
    -------
    dict of str to float or int
        `x, y, z` the base point: where a pole's axis meets the base, the middle of the box of a vehicle or a sign, the
        middle of the lowest metre of a tree; z is the ground's elevation where it is known (a sign's own bottom in any
        case), otherwise the height below which 1 % of
        the points lie, but never more than ten points. `height` of the top above z, `length` and
        `width` of the oriented box (`width` is its longer side but for vehicles, which have both), `azimuth` of
        the longer side in degrees, `tilt` of a pole's axis in degrees, `clearance` between ground and bottom,
        `point_count`, mean `confidence`, all in metres; NaN for what a kind does not have or what is not known.
        `extent` is the longer side for every kind, and `scene` the number of the scene that holds most points of the
        foot.
    """
    low = _bottom(voxels)
    foot = voxels.xyz[:, 2] <= low + _FOOT
    foot[np.argmin(voxels.xyz[:, 2])] = True
    known = voxels.ground[foot & ~np.isnan(voxels.ground)]
    ground = float(np.median(known)) if len(known) else np.nan
    base = low if kind == "sign" or np.isnan(ground) else ground
    centre, length, width, azimuth = oriented_box(voxels.xyz[:, :2])
    tilt = np.nan
    if kind == "tree":
        centre = np.average(voxels.xyz[foot, :2], axis=0, weights=voxels.count[foot])
    axis = fit_axis(voxels.xyz) if kind == "pole" else None
    if axis is not None:
        centre = axis[0] + axis[1] * base
        tilt = float(np.degrees(np.arctan(np.hypot(*axis[1]))))
    vehicle = kind == "vehicle"
    n_points = int(voxels.count.sum())
    return {
        "x": float(centre[0]),
        "y": float(centre[1]),
        "z": float(base),
        "height": float(voxels.z_high.max() - base),
        "length": length if vehicle else np.nan,
        "width": width if vehicle else length,
        "azimuth": azimuth if vehicle or kind == "sign" else np.nan,
        "tilt": tilt,
        "clearance": float(low - ground),
        "point_count": n_points,
        "confidence": float(voxels.confidence.sum() / n_points),
        "extent": length,
        "scene": int(np.argmax(np.bincount(voxels.scene[foot], weights=voxels.count[foot]))),
    }


def _bottom(voxels: Voxels) -> float:
    order = np.argsort(voxels.z_low, kind="stable")
    reached = np.cumsum(voxels.count[order])
    return float(voxels.z_low[order][np.searchsorted(reached, min(_STRAY_SHARE * reached[-1], _STRAY_POINTS))])


def split_at_valleys(voxels: Voxels, *, spacing: float, depth: float, cell: float = 0.5) -> NDArray[np.int32]:
    """Split a group of trees that touch into single ones.

    The highest points over a grid in plan make a canopy; it is flooded from the top. Where the water around two tops
    meets, they are one tree if the valley is less than `depth` below the lower top or the tops are nearer than
    `spacing`, and two otherwise.

    Parameters
    ----------
    voxels : Voxels
        The group.
    spacing : float
        The least distance between two trees' tops in plan, metres.
    depth : float
        The least depth of a valley below the lower top, metres.
    cell : float, default 0.5
        Edge of the grid, metres: coarser closes holes between branches, finer follows narrow valleys.

    Returns
    -------
    ndarray of int32, shape (k,)
        Part of each voxel, 0, 1, ... from the highest top down.
    """
    ij = np.floor(voxels.xyz[:, :2] / cell).astype(np.int64)
    ij -= ij.min(axis=0) - 1
    shape = ij.max(axis=0) + 2
    canopy = np.full(tuple(shape), -np.inf)
    np.maximum.at(canopy, (ij[:, 0], ij[:, 1]), voxels.z_high)
    order = np.argsort(-canopy, axis=None, kind="stable")[: int(np.isfinite(canopy).sum())]
    part = _flood(canopy.ravel(), order, int(shape[1]), spacing / cell, depth)
    _, label = np.unique(part[order], return_index=True)
    number = {int(part[order[first]]): rank for rank, first in enumerate(np.sort(label))}
    cells = part[ij[:, 0] * shape[1] + ij[:, 1]]
    return np.array([number[int(c)] for c in cells], dtype=np.int32)


@njit(cache=True)
def _flood(
    height: NDArray[np.float64], order: NDArray[np.int64], stride: int, spacing: float, depth: float
) -> NDArray[np.int64]:
    """Return the top's cell for every cell of the canopy, -1 outside; cells arrive from the highest down."""
    top = np.full(len(height), -1, np.int64)  # the top whose water a cell is under, before tops are joined
    joined = np.arange(len(height))  # the higher top that swallowed a top
    for cell in order:
        best = -1
        for di in range(-1, 2):
            for dj in range(-1, 2):
                other = top[cell + di * stride + dj]
                if other < 0:
                    continue
                while joined[other] != other:
                    other = joined[other]
                if best < 0:
                    best = other
                elif other != best:
                    high, low = (best, other) if height[best] >= height[other] else (other, best)
                    apart = np.hypot(high // stride - low // stride, high % stride - low % stride)
                    if height[low] - height[cell] < depth or apart < spacing:
                        joined[low] = high
                    best = high
        top[cell] = best if best >= 0 else cell
    for cell in order:
        while joined[top[cell]] != top[cell]:
            top[cell] = joined[top[cell]]
    return top
