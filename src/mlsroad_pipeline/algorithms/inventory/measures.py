"""Measures of one object of the road inventory, from the mean points of its voxels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.axes import Axis, fit_axis
from mlsroad_pipeline.algorithms.inventory.boxes import convex_hull, oriented_box, polygon_area, trimmed, vehicle_box
from mlsroad_pipeline.algorithms.inventory.circles import Circle, fit_circle
from mlsroad_pipeline.algorithms.inventory.panels import fit_panel

# How many points may lie below the bottom: a share, and never more than so many.
_STRAY_SHARE, _STRAY_POINTS = 0.01, 10.0
_FOOT = 1.0  # height of an object's foot, metres: where it meets the ground, and where a trunk stands
_LEAST_LEAN = 0.5  # the tilt below which a direction says nothing, degrees
_SHAFT_SLAB = (0.3, 2.5)  # heights between which a pole's diameter is taken, metres
_TRUNK_SLAB = (0.8, 1.8)  # about breast height, 1.3 m
_TRUNK_TOP = 2.5  # a trunk's axis is fitted below this height, metres
_STEEL, _BARK = 0.015, 0.03  # how far points may lie from the circle of a pole and of a trunk, metres
_STRAY_FOOT = 0.02  # share of voxels of a tree's foot that its middle leaves out on each side
_CLEAR = 0.45  # how far points of the slab may lie from the axis, metres
_SIDE_STEP = 0.25  # length of the pieces of a vehicle's sides that are seen or not, metres
_TWO_POSTS = 0.5  # points below a panel that spread this far along it are of two posts, metres

MEASURES = (
    "x", "y", "z", "height", "width", "length", "heading", "tilt", "lean_azimuth", "diameter", "crown_diameter",
    "panel_bottom", "panel_centre", "panel_height", "panel_width", "facing", "clearance", "visible_share",
)  # fmt: skip
"""Names of the measures that are numbers; NaN is what an object does not have or what was not seen."""


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


@dataclass(frozen=True)
class _Found:
    """What all kinds of measures start from."""

    xyz: NDArray[np.float64]
    hull: NDArray[np.float64]
    foot: NDArray[np.bool_]
    base: float
    ground: float
    low: float
    top: float


def measure(voxels: Voxels, kind: str) -> dict[str, float | int | str]:
    """Measure an object.

    Parameters
    ----------
    voxels : Voxels
        The object; at least one voxel.
    kind : str
        ``pole``, ``sign``, ``vehicle`` or ``tree``.

    Returns
    -------
    dict of str to float, int or str
        The numbers of `MEASURES` as docs/inventory.md defines them, lengths in metres and angles in degrees;
        `footprint`, its convex hull in plan as WKT, empty where that is no area; `facing_from`, what told the side that
        a panel is read from; `point_count`; `score`, the mean confidence; `extent`, the longer side of the box in plan;
        `scene`, the number of the scene that holds most of the foot.
    """
    low = _bottom(voxels)
    foot = voxels.xyz[:, 2] <= low + _FOOT
    foot[np.argmin(voxels.xyz[:, 2])] = True
    known = voxels.ground[foot & ~np.isnan(voxels.ground)]
    ground = float(np.median(known)) if len(known) else np.nan
    base = low if np.isnan(ground) else ground
    hull = convex_hull(voxels.xyz[:, :2])
    found = _Found(voxels.xyz, hull, foot, base, ground, low, float(voxels.z_high.max()))
    centre, length, _, _ = oriented_box(hull)
    n_points = int(voxels.count.sum())
    row: dict[str, float | int | str] = dict.fromkeys(MEASURES, np.nan)
    row |= {"x": float(centre[0]), "y": float(centre[1]), "z": base, "height": found.top - base, "width": length}
    row |= {"clearance": low - ground, "facing_from": "", "footprint": _as_wkt(hull)}
    if kind == "pole":
        row |= _pole(found)
    elif kind == "sign":
        row |= _sign(found)
    elif kind == "vehicle":
        row |= _vehicle(found)
    elif kind == "tree":
        row |= _tree(found)
    return row | {
        "point_count": n_points,
        "score": float(voxels.confidence.sum() / n_points),
        "extent": length,
        "scene": int(np.argmax(np.bincount(voxels.scene[foot], weights=voxels.count[foot]))),
    }


def _bottom(voxels: Voxels) -> float:
    """Return the height below which the stray points lie."""
    allowed = min(_STRAY_SHARE * voxels.count.sum(), _STRAY_POINTS)
    lowest = voxels.z_low
    if len(lowest) > _STRAY_POINTS + 1:  # as each voxel has a point, the rest lies above
        few = np.argpartition(lowest, int(_STRAY_POINTS) + 1)[: int(_STRAY_POINTS) + 2]
        lowest, count = lowest[few], voxels.count[few]
    else:
        count = voxels.count
    order = np.argsort(lowest, kind="stable")
    return float(lowest[order][np.searchsorted(np.cumsum(count[order]), allowed)])


def _as_wkt(hull: NDArray[np.float64]) -> str:
    corners = np.round(hull, 2)
    if len(corners) < 3 or polygon_area(corners) < 1e-4:
        return ""
    ring = ", ".join([f"{x:.2f} {y:.2f}" for x, y in (*corners.tolist(), corners[0].tolist())])
    return f"POLYGON (({ring}))"


def _leaning(axis: Axis) -> dict[str, float]:
    clear = axis.tilt >= _LEAST_LEAN and np.tan(np.radians(axis.tilt)) >= 2 * axis.error
    return {"tilt": axis.tilt, "lean_azimuth": axis.direction if clear else np.nan}


def _round_shaft(found: _Found, axis: Axis, slab: tuple[float, float], *, band: float) -> Circle | None:
    """Fit a circle about the axis to what lies between two heights, seen along the axis."""
    z = found.xyz[:, 2] - found.base
    part = found.xyz[(z >= slab[0]) & (z <= slab[1])]
    flat = part[:, :2] - axis.foot - axis.slope * part[:, 2:]
    return fit_circle(flat[np.hypot(*flat.T) <= _CLEAR], reach=_CLEAR / 2, band=band)


def _pole(found: _Found) -> dict[str, float]:
    axis = fit_axis(found.xyz)
    if axis is None:
        return {}
    base, diameter = axis.at(found.base), np.nan
    circle = _round_shaft(found, axis, _SHAFT_SLAB, band=_STEEL)
    if circle is not None:
        base, diameter = base + circle.centre, circle.diameter
    return {"x": base[0], "y": base[1], "diameter": diameter, "visible_share": axis.share, **_leaning(axis)}


def _sign(found: _Found) -> dict[str, float | str]:
    panel = fit_panel(found.xyz)
    if panel is None:
        return {"facing_from": "", **_post(found, found.xyz)}
    row: dict[str, float | str] = {
        "x": panel.centre[0], "y": panel.centre[1],
        "panel_bottom": panel.bottom - found.base, "panel_centre": panel.centre[2] - found.base,
        "panel_height": panel.top - panel.bottom, "panel_width": panel.width, "facing": panel.normal,
        "facing_from": "post" if panel.faces else "unknown",
    }  # fmt: skip
    below = found.xyz[found.xyz[:, 2] < panel.bottom - 0.05]
    row |= _post(found, below)
    if len(below):
        turn = np.radians(panel.normal)
        along = np.array([np.cos(turn), -np.sin(turn)])
        first, last = trimmed(below[:, :2] @ along, 0.05)
        if last - first > _TWO_POSTS:  # a board on two posts stands in their middle
            base = np.array([row["x"], row["y"]])
            base += ((first + last) / 2 - base @ along) * along
            row |= {"x": base[0], "y": base[1]}
    return row


def _post(found: _Found, points: NDArray[np.float64]) -> dict[str, float]:
    """Measure the post of a sign, where enough of it was seen."""
    axis = fit_axis(points)
    if axis is None:
        return {}
    base = axis.at(found.base)
    return {"x": base[0], "y": base[1], "visible_share": axis.share, **_leaning(axis)}


def _vehicle(found: _Found) -> dict[str, float]:
    centre, length, width, azimuth = vehicle_box(found.xyz[:, :2])
    turn = np.radians(azimuth)
    local = (found.xyz[:, :2] - centre) @ np.array([[np.sin(turn), np.cos(turn)], [np.cos(turn), -np.sin(turn)]]).T
    return {
        "x": centre[0], "y": centre[1], "length": length, "width": width, "heading": azimuth,
        "visible_share": _sides_seen(local, length, width),
    }  # fmt: skip


def _sides_seen(local: NDArray[np.float64], length: float, width: float) -> float:
    """Return the share of a rectangle's sides beside which there are points; local is along and across it."""
    seen, total = 0, 0
    for axis, (long, wide) in enumerate(((length, width), (width, length))):
        pieces = max(int(np.ceil(long / _SIDE_STEP)), 1)
        piece = np.clip(((local[:, axis] / max(long, 1e-9) + 0.5) * pieces).astype(np.int64), 0, pieces - 1)
        for side in (-1, 1):
            near = side * local[:, 1 - axis] >= wide / 2 - _SIDE_STEP
            seen += int(np.count_nonzero(np.bincount(piece[near], minlength=pieces)))
            total += pieces
    return seen / total


def _tree(found: _Found) -> dict[str, float]:
    foot = found.xyz[found.foot, :2]
    middle = (found.hull.max(axis=0) + found.hull.min(axis=0)) / 2
    base = np.array([sum(trimmed(foot[:, axis], _STRAY_FOOT)) / 2 for axis in range(2)])
    if found.low - found.ground > _FOOT:
        base = middle  # the trunk was not seen, and a low branch is not where it stands
    diameter = np.nan
    axis = fit_axis(found.xyz[found.xyz[:, 2] <= found.base + _TRUNK_TOP])
    if axis is not None:
        circle = _round_shaft(found, axis, _TRUNK_SLAB, band=_BARK)
        diameter = np.nan if circle is None else circle.diameter
    around = np.arctan2(*(found.xyz[:, :2] - middle).T[::-1])
    seen = np.bincount(np.floor((around / (2 * np.pi) + 0.5) * 36).astype(np.int64) % 36, minlength=36) > 0
    return {
        "x": base[0], "y": base[1], "diameter": diameter, "visible_share": float(seen.mean()),
        "crown_diameter": 2 * np.sqrt(polygon_area(found.hull) / np.pi),
    }  # fmt: skip
