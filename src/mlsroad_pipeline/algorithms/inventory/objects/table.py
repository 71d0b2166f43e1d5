"""Table of road objects: columns, units, numbering, lasting keys, and links between signs and poles."""

from collections.abc import Mapping, Sequence, Set
from functools import lru_cache
from typing import Any, NamedTuple
from uuid import UUID, uuid5

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.geometry.assignment import assign_one_to_one
from mlsroad_pipeline.algorithms.inventory.objects.measures import EXTENT, MEASURES
from mlsroad_pipeline.algorithms.inventory.objects.plate_shapes import PLATE_SHAPES
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory


class Field(NamedTuple):
    """Column of the inventory: type, heading with the unit, definition, and all values but an empty one, if listed."""

    dtype: str
    alias: str
    description: str
    values: tuple[str, ...] = ()


FIELDS: dict[str, Field] = {
    "object_id": Field("int64", "Object", "Number of the object, from 1, by class and place."),
    "key": Field("str", "Key", "UUID that the object keeps in later runs and surveys; empty in tables of one scene."),
    "class": Field("str", "Class", "Class of the scheme that the survey was labelled in."),
    "kind": Field("str", "Kind", "What is measured of it: pole, sign, vehicle or tree.", KINDS),
    "score": Field("float64", "Score", "Probability that it is an object of its kind, 0 to 1."),
    "x": Field("float64", "Easting [m]", "Base point, first coordinate of the survey's reference system."),
    "y": Field("float64", "Northing [m]", "Base point, second coordinate of the survey's reference system."),
    "z": Field("float64", "Base elevation [m]", "Elevation of the ground at the base point, else of its lowest part."),
    "height": Field("float64", "Height [m]", "Top above the base."),
    "width": Field(
        "float64", "Width [m]", "Longer side of its box in plan; of a vehicle the shorter, without mirrors."
    ),
    "length": Field("float64", "Length [m]", "Longer side of a vehicle's box."),
    "heading": Field(
        "float64", "Heading [deg]", "Direction of a vehicle's length, clockwise from grid north, 0 to 180."
    ),
    "complete": Field("str", "Box", "Of a vehicle: measured, or which sides of its box are assumed to be a car's."),
    "motion": Field(
        "str", "Motion", "moving: a vehicle seen more briefly than what stands beside it; else empty.", ("moving",)
    ),
    "tilt": Field("float64", "Tilt [deg]", "Angle between the axis of a pole or post and the vertical."),
    "lean_azimuth": Field(
        "float64", "Leans towards [deg]", "Where its top leans, clockwise from grid north, 0 to 360."
    ),
    "pole_type": Field("str", "Type", "Of a pole: utility where overhead wires run to it; else empty.", ("utility",)),
    "diameter": Field("float64", "Diameter [m]", "Of a round pole's shaft, or of a trunk at breast height."),
    "crown_diameter": Field("float64", "Crown diameter [m]", "Of the circle with the area of a tree's footprint."),
    "panel_bottom": Field("float64", "Panel lower edge [m]", "Lower edge of a sign's panel above the base."),
    "panel_centre": Field("float64", "Panel middle [m]", "Middle of a sign's panel above the base."),
    "panel_height": Field("float64", "Panel height [m]", "Vertical size of a sign's panel."),
    "panel_width": Field("float64", "Panel width [m]", "Horizontal size of a sign's panel."),
    "panel_shape": Field(
        "str", "Panel shape", "Of a sign: round (octagons too), triangle or rectangle; else empty.", PLATE_SHAPES
    ),
    "facing": Field("float64", "Facing [deg]", "Direction of a sign's front, clockwise from grid north, 0 to 360."),
    "facing_from": Field(
        *("str", "Front known from", "Evidence for a sign's front: post, pole or unknown (facing below 180)."),
        ("post", "pole", "unknown"),
    ),
    "clearance": Field("float64", "Clearance [m]", "Its lowest part above the ground."),
    "visible_share": Field("float64", "Visible share", "How much of its height or outline has points, 0 to 1."),
    "station": Field("float64", "Station [m]", "Way along the trajectory to the place beside the object."),
    "offset": Field("float64", "Offset [m]", "Distance from the trajectory, positive to the right."),
    "pole_id": Field("int64", "On pole", "Number of the pole that a sign hangs on, 0 where there is none."),
    "point_count": Field("int64", "Points", "Number of its points."),
    "x_min": Field("float64", "Least easting [m]", "Smallest first coordinate of its points."),
    "x_max": Field("float64", "Largest easting [m]", "Largest first coordinate of its points."),
    "y_min": Field("float64", "Least northing [m]", "Smallest second coordinate of its points."),
    "y_max": Field("float64", "Largest northing [m]", "Largest second coordinate of its points."),
    "z_min": Field("float64", "Lowest point [m]", "Smallest elevation of its points."),
    "z_max": Field("float64", "Highest point [m]", "Largest elevation of its points."),
    "disagreeing_share": Field("float64", "Other class", "Share of its points that were labelled as another class."),
    "file_count": Field("int64", "Files", "Number of files that hold its points, 0 where unknown."),
    "passes": Field("int64", "Passes", "Number of passes of the scanner that saw it, 0 where unknown."),
    "passes_there": Field("int64", "Passes there", "Number of passes through the scenes that it lies in, 0 unknown."),
    "scanners": Field("int64", "Scanners", "Number of scanners that saw it, 0 where unknown."),
    "scanners_there": Field("int64", "Scanners there", "Number of scanners in the scenes that it lies in, 0 unknown."),
    "first_time": Field(
        "float64", "First seen [s]", "Time of its first point, in whole seconds of the files' GPS time."
    ),
    "first_date": Field("str", "Seen on", "Date of first_time, ISO 8601; empty where the times are seconds of a week."),
    "last_time": Field("float64", "Last seen [s]", "Time of its last point, in whole seconds of the files' GPS time."),
    "status": Field(
        *(
            "str",
            "Status",
            "Decision of a user: accepted, rejected, changed, merged, split, moved or added, else empty.",
        ),
        ("accepted", "rejected", "changed", "merged", "split", "moved", "added"),
    ),
    "checked_class": Field("str", "Checked class", "Class or kind that a user gave; empty without one."),
    "reasons": Field("str", "Reasons", "What the score rests on, in phrases separated by semicolons."),
    "scene": Field("str", "Scene", "Scene that holds its base."),
    "method": Field("str", "Method", "Method that found it."),
    "model_version": Field("str", "Model", "Registered model and version of the method."),
    "footprint": Field("str", "Footprint (WKT)", "Convex hull of its points in plan, empty where that is no area."),
}
"""Columns of an object table in order; see docs/inventory_fields.md."""

OBJECT_FIELDS = {name: field.dtype for name, field in FIELDS.items()}
"""Columns of an object table and their types."""

FIELDS_OF_KINDS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("length", "heading", "complete", "motion"), ("vehicle",)),
    **dict.fromkeys(("tilt", "lean_azimuth"), ("pole", "sign")),
    "pole_type": ("pole",),
    "diameter": ("pole", "tree"),
    "crown_diameter": ("tree",),
    **dict.fromkeys(
        (
            *("panel_bottom", "panel_centre", "panel_height", "panel_width", "panel_shape"),
            *("facing", "facing_from", "pole_id"),
        ),
        ("sign",),
    ),
}
"""Column to the kinds that have it; all kinds have the others."""


def fields_of_kind(kind: str) -> list[str]:
    """Return the columns that objects of a kind have, in the order of `FIELDS`.

    Examples
    --------
    >>> [name for name in fields_of_kind("vehicle") if name in FIELDS_OF_KINDS]
    ['length', 'heading', 'complete', 'motion']
    """
    return [name for name in FIELDS if kind in FIELDS_OF_KINDS.get(name, (kind,))]


SEEN_BY = ("file_count", "passes", "passes_there", "scanners", "scanners_there")
"""Counts of files, passes and scanners; 0 is unknown."""

_DECIMALS = {
    **dict.fromkeys((*MEASURES, *EXTENT, "station", "offset"), 3),
    **dict.fromkeys(("heading", "tilt", "lean_azimuth", "facing", "visible_share"), 2),
    **dict.fromkeys(("score", "disagreeing_share"), 4),
}
_LINK_DISTANCE = 0.75  # largest distance of a pole's base from the edge of a sign that it carries, metres
_LEAST_STANDOFF = 0.03  # minimum distance of a panel from the axis of its pole for a known side, metres


def empty_table(fields: Mapping[str, str]) -> pd.DataFrame:
    """Return an empty table with typed columns, such as `OBJECT_FIELDS`."""
    return _empty(tuple(fields.items())).copy()


@lru_cache(maxsize=64)
def _empty(fields: tuple[tuple[str, str], ...]) -> pd.DataFrame:
    """Return an empty table, which must not be changed; pandas takes several milliseconds to make one."""
    return pd.DataFrame({name: pd.Series(dtype=dtype) for name, dtype in fields})


def object_table(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """Return the table of measured objects; numbers, links and stationing are not set."""
    if not rows:
        return empty_table(OBJECT_FIELDS)
    unknown: dict[str, Any] = {
        **dict.fromkeys(("object_id", "pole_id", *SEEN_BY), 0),
        **dict.fromkeys(("station", "offset", "first_time", "last_time"), np.nan),
        **dict.fromkeys(("method", "model_version", "status", "checked_class", "reasons", "motion", "key"), ""),
        **dict.fromkeys(("pole_type", "panel_shape", "first_date"), ""),
    }
    known = pd.DataFrame(list(rows))
    missing = {name: value for name, value in unknown.items() if name not in known}
    return known.assign(**missing)[list(OBJECT_FIELDS)].astype(OBJECT_FIELDS)


def finish_table(
    objects: pd.DataFrame, classes: Sequence[str], trajectory: Trajectory | None
) -> tuple[pd.DataFrame, NDArray[np.int64]]:
    """Add stationing, round, sort, number and link the objects of a pass; return them with their earlier `object_id`.

    A sign is linked to the nearest pole within 0.75 m of its edge in plan that reaches its lower edge to within 0.75 m.
    A panel without a post of its own faces away from that pole.
    """
    table = objects.copy()
    if trajectory is not None and len(table):
        table["station"], table["offset"] = trajectory.locate(table[["x", "y", "z"]].to_numpy())
    table = table.round(_DECIMALS)
    rank = table["class"].map({name: i for i, name in enumerate(classes)})
    by = ["rank", "station", "x", "y", "z", "point_count"]
    table = table.assign(rank=rank).sort_values(by, kind="stable").drop(columns="rank").reset_index(drop=True)
    earlier = table["object_id"].to_numpy(dtype=np.int64)
    table = table.assign(object_id=np.arange(1, len(table) + 1))
    return _link_signs(table)[list(OBJECT_FIELDS)].astype(OBJECT_FIELDS), earlier


def _link_signs(table: pd.DataFrame) -> pd.DataFrame:
    """Link signs to poles; the pole also determines the side of a panel without a post."""
    poles, signs = table[table["kind"] == "pole"], table[table["kind"] == "sign"]
    if poles.empty or signs.empty:
        return table
    tree = cKDTree(poles[["x", "y"]].to_numpy())
    low, height, number = (poles[name].to_numpy() for name in ("z", "height", "object_id"))
    lean = np.tan(np.radians(poles["tilt"].fillna(0.0).to_numpy()))
    where = np.radians(poles["lean_azimuth"].fillna(0.0).to_numpy())
    way = np.column_stack([np.sin(where), np.cos(where)]) * lean[:, None]
    linked, facing, source = (table[name].to_numpy().copy() for name in ("pole_id", "facing", "facing_from"))
    columns = ["x", "y", "z", "height", "width", "clearance", "panel_centre"]
    for row, (x, y, z, tall, width, clearance, centre) in zip(signs.index, signs[columns].to_numpy(), strict=True):
        near = np.array(tree.query_ball_point([x, y], _LINK_DISTANCE + width / 2, return_sorted=True), dtype=np.int64)
        bottom = z + np.nan_to_num(clearance)
        near = near[(low[near] + height[near] >= bottom - _LINK_DISTANCE) & (low[near] <= z + tall)]
        if not len(near):
            continue
        pole = near[np.argmin(np.hypot(tree.data[near, 0] - x, tree.data[near, 1] - y))]
        linked[row] = number[pole]
        turn = np.radians(facing[row])
        out = np.array([x, y]) - tree.data[pole] - way[pole] * (z + centre - low[pole])
        standoff = float(out @ [np.sin(turn), np.cos(turn)])
        if source[row] == "unknown" and _LEAST_STANDOFF <= abs(standoff) <= _LINK_DISTANCE:
            facing[row], source[row] = facing[row] if standoff > 0 else (facing[row] + 180.0) % 360.0, "pole"
    return table.assign(pole_id=linked, facing=facing, facing_from=source)


REACH = {"pole": 1.0, "sign": 1.0, "tree": 2.0, "vehicle": 1.5}
"""Kind to the largest distance in plan of the places of one object in two inventories, metres."""

_OTHER_KIND = 0.5  # an object whose kind is another now, metres
_SPACE = UUID("5f0a1d5e-7c0b-4f0e-9a55-3d1c6c0f4a21")


def lasting_keys(objects: pd.DataFrame, *earlier: pd.DataFrame, crs: str | None = None) -> NDArray[np.object_]:
    """Return the key of each object: that of the first earlier inventory with the same object, else a new one.

    Objects are the same if they are of one kind and at most `REACH` apart, one to one. What is left is matched
    regardless of its kind within 0.5 m, vehicles excepted: a user may have changed a tree to a pole. A new key follows
    from kind, place and reference system alone, so two runs with the same objects give the same keys.
    """
    keys = np.full(len(objects), "", dtype=np.object_)
    groups = [((kind,), reach) for kind, reach in REACH.items()]
    for table in earlier:
        known = table[(table["key"] != "") & ~table["key"].isin(keys)].drop_duplicates("key")
        free = np.ones(len(known), dtype=np.bool_)
        for kinds, reach in [*groups, (tuple(kind for kind in KINDS if kind != "vehicle"), _OTHER_KIND)]:
            here = np.flatnonzero(objects["kind"].isin(kinds).to_numpy() & (keys == ""))
            there = np.flatnonzero(known["kind"].isin(kinds).to_numpy() & free)
            mine, other = assign_one_to_one(_places(objects, here), _places(known, there), reach)
            keys[here[mine]] = known["key"].to_numpy(dtype=np.object_)[there[other]]
            free[there[other]] = False
    taken = {key for table in earlier for key in table["key"]}
    return new_keys(objects.assign(key=keys), taken=taken, crs=crs)


def new_keys(objects: pd.DataFrame, *, taken: Set[str] = frozenset(), crs: str | None = None) -> NDArray[np.object_]:
    """Return the column `key` of a table of objects, with new keys, none of them in `taken`, where it is empty."""
    keys = objects["key"].to_numpy(dtype=np.object_, copy=True)
    others = {*taken, *keys}
    for row in np.flatnonzero(keys == ""):
        place = objects.iloc[row]
        keys[row] = _new_key(f"{crs or ''} {place['kind']} {place['x']:.2f} {place['y']:.2f}", others)
        others.add(keys[row])
    return keys


def _places(table: pd.DataFrame, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    return table[["x", "y"]].to_numpy(dtype=np.float64)[rows]


def _new_key(text: str, taken: Set[str]) -> str:
    """Return the key of a text that nothing has yet."""
    key, number = str(uuid5(_SPACE, text)), 1
    while key in taken:
        number += 1
        key = str(uuid5(_SPACE, f"{text} {number}"))
    return key
