"""Measures of an object of the inventory from the mean points of its voxels."""

from dataclasses import dataclass
from typing import TypedDict, cast

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.objects.axes import Axis, Circle, fit_axis, fit_circle
from mlsroad_pipeline.algorithms.inventory.objects.boxes import (
    convex_hull,
    oriented_box,
    polygon_area,
    trimmed,
    vehicle_box,
)
from mlsroad_pipeline.algorithms.inventory.objects.panels import fit_panel
from mlsroad_pipeline.algorithms.inventory.objects.trunks import Trunk, find_trunks, main_trunk
from mlsroad_pipeline.algorithms.inventory.objects.voxel_sums import Voxels

# Points below the bottom: largest share and largest number.
_STRAY_SHARE, _STRAY_POINTS = 0.01, 10.0
_FOOT = 1.0  # height of the foot of an object, metres
_LEAST_LEAN = 0.5  # minimum tilt for a direction of lean, degrees
_SHAFT_SLAB = (0.3, 2.5)  # heights for the diameter of a pole, metres
_TRUNK_SLAB = (0.8, 1.8)  # about breast height, 1.3 m
_TRUNK_TOP = 2.5  # largest height for the axis of a trunk, metres
_STEEL, _BARK = 0.015, 0.03  # largest distance of points from the circle of a pole and of a trunk, metres
_TRUNK_OFFSET = 0.6  # distance from the mean of the foot at which a trunk needs the following share, metres
_TRUNK_SHARE, _LOW = 0.12, 2.1  # least share of a trunk in the voxels up to a height in metres
_CLEAR = 0.45  # largest distance of points of the slab from the axis, metres
_CAR_LENGTH, _CAR_WIDTH = 4.2, 1.75  # of a car that is seen in part, metres
_CAR_HEIGHT = 2.2  # above which a vehicle is a van, lorry or bus, metres
_END = (1.4, 2.3)  # range of the longer side where only an end is seen, metres
_SIDE_LENGTH, _CAR_SIDE = 3.3, 1.45  # least length of a side, and width of an end, of a car, metres
_ONE_SIDED = 1.2  # least ratio of the voxels at opposite sides that tells the side of the scanner
_SIDE_STEP = 0.25  # length of the segments of a vehicle's sides, metres
_TWO_POSTS = 0.5  # minimum extent along the panel of the points of two posts, metres

MEASURES = (
    "x", "y", "z", "height", "width", "length", "heading", "tilt", "lean_azimuth", "diameter", "crown_diameter",
    "panel_bottom", "panel_centre", "panel_height", "panel_width", "facing", "clearance", "visible_share",
)  # fmt: skip
"""Names of the numeric measures; NaN is not applicable or not visible."""

EXTENT = ("x_min", "x_max", "y_min", "y_max", "z_min", "z_max")
"""Names of the smallest and largest coordinates of the points."""


class ObjectMeasures(TypedDict, total=False):
    """Measures of an object: those of `MEASURES`, as docs/inventory_fields.md defines them, and the following.

    Lengths are in metres, angles in degrees. NaN is not applicable or not visible.
    """

    x: float
    y: float
    z: float
    height: float
    width: float
    length: float
    heading: float
    tilt: float
    lean_azimuth: float
    diameter: float
    crown_diameter: float
    panel_bottom: float
    panel_centre: float
    panel_height: float
    panel_width: float
    facing: float
    clearance: float
    visible_share: float
    # x_min, x_max, y_min, y_max, z_min, z_max: smallest and largest coordinates of the points
    x_min: float
    x_max: float
    y_min: float
    y_max: float
    z_min: float
    z_max: float
    facing_from: str  # Source of the facing of a panel: ``post``, ``unknown``, or empty
    panel_shape: str  # One of `PLATE_SHAPES`, or empty
    complete: str  # Of a vehicle: ``measured``, or what of its box is assumed; else empty
    footprint: str  # Convex hull in plan as WKT; empty if it has no area
    point_count: int  # Number of points
    disagreeing_share: float  # Share of the points whose own label is of another class
    score: float  # Mean confidence
    extent: float  # Longer side of the box in plan
    scene: int  # Number of the scene that contains most of the foot


@dataclass(frozen=True)
class _Geometry:
    """Points and outlines of an object, shared by the measures of all kinds."""

    xyz: NDArray[np.float64]
    hull: NDArray[np.float64]
    foot: NDArray[np.bool_]
    base: float
    ground: float
    low: float
    top: float


def measure(voxels: Voxels, kind: str) -> ObjectMeasures:
    """Measure an object."""
    low = _bottom(voxels)
    foot = voxels.xyz[:, 2] <= low + _FOOT
    foot[np.argmin(voxels.xyz[:, 2])] = True
    known = voxels.ground[foot & ~np.isnan(voxels.ground)]
    ground = float(np.median(known)) if len(known) else np.nan
    base = low if np.isnan(ground) else ground
    hull = convex_hull(voxels.xyz[:, :2])
    geometry = _Geometry(voxels.xyz, hull, foot, base, ground, low, float(voxels.z_high.max()))
    centre, length, _, _ = oriented_box(hull)
    n_points = int(voxels.count.sum())
    row = cast(ObjectMeasures, dict.fromkeys(MEASURES, np.nan))
    row |= {"x": float(centre[0]), "y": float(centre[1]), "z": base, "height": geometry.top - base, "width": length}
    row |= {"clearance": low - ground, "footprint": _as_wkt(hull)}
    row |= {"facing_from": "", "complete": "", "panel_shape": ""}
    if kind == "pole":
        row |= _pole(geometry)
    elif kind == "sign":
        row |= _sign(geometry)
    elif kind == "vehicle":
        row |= _vehicle(geometry)
    elif kind == "tree":
        row |= _tree(geometry, main_trunk(find_trunks(voxels)))
    row |= {"point_count": n_points, "score": float(voxels.confidence.sum() / n_points), "extent": length}
    row["disagreeing_share"] = float(voxels.disagreeing.sum() / n_points)
    sides = np.column_stack([voxels.low.min(axis=0), voxels.high.max(axis=0)]).ravel().tolist()
    row = cast(ObjectMeasures, {**row, **dict(zip(EXTENT, sides, strict=True))})
    row["scene"] = int(np.argmax(np.bincount(voxels.scene[foot], weights=voxels.count[foot])))
    return row


def _bottom(voxels: Voxels) -> float:
    """Return the elevation of the bottom, robust to stray points below it."""
    allowed = min(_STRAY_SHARE * voxels.count.sum(), _STRAY_POINTS)
    lowest = voxels.z_low
    if len(lowest) > _STRAY_POINTS + 1:  # each voxel has a point, so the others are not needed
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


def _leaning(axis: Axis) -> ObjectMeasures:
    clear = axis.tilt >= _LEAST_LEAN and np.tan(np.radians(axis.tilt)) >= 2 * axis.error
    return {"tilt": axis.tilt, "lean_azimuth": axis.direction if clear else np.nan}


def _round_shaft(geometry: _Geometry, axis: Axis, slab: tuple[float, float], *, band: float) -> Circle | None:
    """Fit a circle around the axis to the points between two heights, projected along the axis."""
    z = geometry.xyz[:, 2] - geometry.base
    part = geometry.xyz[(z >= slab[0]) & (z <= slab[1])]
    flat = part[:, :2] - axis.foot - axis.slope * part[:, 2:]
    return fit_circle(flat[np.hypot(*flat.T) <= _CLEAR], reach=_CLEAR / 2, band=band)


def _pole(geometry: _Geometry) -> ObjectMeasures:
    axis = fit_axis(geometry.xyz)
    if axis is None:
        return {}
    base, diameter = axis.at(geometry.base), np.nan
    circle = _round_shaft(geometry, axis, _SHAFT_SLAB, band=_STEEL)
    if circle is not None:
        base, diameter = base + circle.centre, circle.diameter
    return {"x": base[0], "y": base[1], "diameter": diameter, "visible_share": axis.share, **_leaning(axis)}


def _sign(geometry: _Geometry) -> ObjectMeasures:
    panel = fit_panel(geometry.xyz)
    if panel is None:
        return {"facing_from": "", **_post(geometry, geometry.xyz)}
    row: ObjectMeasures = {
        "x": panel.centre[0], "y": panel.centre[1],
        "panel_bottom": panel.bottom - geometry.base, "panel_centre": panel.centre[2] - geometry.base,
        "panel_height": panel.top - panel.bottom, "panel_width": panel.width, "facing": panel.normal,
        "facing_from": "post" if panel.faces else "unknown", "panel_shape": panel.shape,
    }  # fmt: skip
    below = geometry.xyz[geometry.xyz[:, 2] < panel.bottom - 0.05]
    row |= _post(geometry, below)
    if len(below):
        turn = np.radians(panel.normal)
        along = np.array([np.cos(turn), -np.sin(turn)])
        first, last = trimmed(below[:, :2] @ along, 0.05)
        if last - first > _TWO_POSTS:  # a panel on two posts has its base between them
            base = np.array([row["x"], row["y"]])
            base += ((first + last) / 2 - base @ along) * along
            row |= {"x": base[0], "y": base[1]}
    return row


def _post(geometry: _Geometry, points: NDArray[np.float64]) -> ObjectMeasures:
    """Measure the post of a sign if enough of it is visible."""
    axis = fit_axis(points)
    if axis is None:
        return {}
    base = axis.at(geometry.base)
    return {"x": base[0], "y": base[1], "visible_share": axis.share, **_leaning(axis)}


def _vehicle(geometry: _Geometry) -> ObjectMeasures:
    centre, length, width, azimuth = vehicle_box(geometry.xyz[:, :2])
    turn = np.radians(azimuth)
    local = (geometry.xyz[:, :2] - centre) @ np.array([[np.sin(turn), np.cos(turn)], [np.cos(turn), -np.sin(turn)]]).T
    return {
        "x": centre[0], "y": centre[1], "length": length, "width": width, "heading": azimuth,
        "visible_share": _sides_seen(local, length, width),
    }  # fmt: skip


def complete_vehicle(row: ObjectMeasures, voxels: Voxels) -> ObjectMeasures:
    """Return length, width, heading, place and `complete` of a vehicle seen in part, with the size of a car assumed.

    What is narrower than a car is extended away from the scanner: from the side of the box with most voxels. So is a
    piece of a side as wide as a car. Of what is hardly longer than a car is wide, an end is seen: its longer side is
    the width. Vehicles higher than cars keep their box.
    """
    length, width, heading = row["length"], row["width"], row["heading"]
    end = _END[0] <= length < _END[1]
    side = length >= _SIDE_LENGTH
    car = row["height"] < _CAR_HEIGHT and (end or side or width >= _CAR_SIDE)
    if not car or (side and width >= _CAR_WIDTH):
        return {"complete": "measured"}
    if end:
        length, width, heading = width, length, (heading + 90.0) % 180.0
    turn = np.radians(heading)
    axes = np.array([[np.sin(turn), np.cos(turn)], [np.cos(turn), -np.sin(turn)]])
    centre = np.array([row["x"], row["y"]])
    local = (voxels.xyz[:, :2] - centre) @ axes.T
    sizes = (length, width)
    wanted = (length if side else max(length, _CAR_LENGTH), max(width, _CAR_WIDTH))
    for k, (size, whole) in enumerate(zip(sizes, wanted, strict=True)):
        first, last = (np.count_nonzero(side * local[:, k] > size / 2 - _SIDE_STEP) for side in (-1, 1))
        if max(first, last) > _ONE_SIDED * min(first, last):
            centre = centre + np.sign(first - last) * (whole - size) / 2 * axes[k]
    assumed = [name for name, size, whole in zip(("length", "width"), sizes, wanted, strict=True) if whole > size]
    return {
        "x": float(centre[0]), "y": float(centre[1]), "length": wanted[0], "width": wanted[1], "heading": heading,
        "complete": " and ".join(assumed) + " assumed",
    }  # fmt: skip


def _sides_seen(local: NDArray[np.float64], length: float, width: float) -> float:
    """Return the share of the sides of a rectangle with points nearby; `local` is along and across it."""
    seen, total = 0, 0
    for axis, (long, wide) in enumerate(((length, width), (width, length))):
        pieces = max(int(np.ceil(long / _SIDE_STEP)), 1)
        piece = np.clip(((local[:, axis] / max(long, 1e-9) + 0.5) * pieces).astype(np.int64), 0, pieces - 1)
        for side in (-1, 1):
            near = side * local[:, 1 - axis] >= wide / 2 - _SIDE_STEP
            seen += int(np.count_nonzero(np.bincount(piece[near], minlength=pieces)))
            total += pieces
    return seen / total


def _tree(geometry: _Geometry, trunk: Trunk | None) -> ObjectMeasures:
    base = geometry.xyz[geometry.foot, :2].mean(axis=0)
    if trunk is not None:
        beside = np.hypot(trunk.x - base[0], trunk.y - base[1]) > _TRUNK_OFFSET
        low = np.count_nonzero(geometry.xyz[:, 2] < geometry.base + _LOW)
        if not (beside and len(trunk.voxels) < _TRUNK_SHARE * low):  # else one of many hanging branches
            base = np.array([trunk.x, trunk.y])
    middle = (geometry.hull.max(axis=0) + geometry.hull.min(axis=0)) / 2
    diameter = np.nan
    axis = fit_axis(geometry.xyz[geometry.xyz[:, 2] <= geometry.base + _TRUNK_TOP])
    if axis is not None:
        circle = _round_shaft(geometry, axis, _TRUNK_SLAB, band=_BARK)
        diameter = np.nan if circle is None else circle.diameter
    around = np.arctan2(*(geometry.xyz[:, :2] - middle).T[::-1])
    seen = np.bincount(np.floor((around / (2 * np.pi) + 0.5) * 36).astype(np.int64) % 36, minlength=36) > 0
    return {
        "x": base[0], "y": base[1], "diameter": diameter, "visible_share": float(seen.mean()),
        "crown_diameter": 2 * np.sqrt(polygon_area(geometry.hull) / np.pi),
    }  # fmt: skip
