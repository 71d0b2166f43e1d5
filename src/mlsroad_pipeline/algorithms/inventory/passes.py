"""One inventory of several passes: an object or a line that two passes recorded is listed once.

Objects of one kind that lie within a small distance of each other in two passes are one object, one to one. It has the
measures of the pass with the higher score, and the points of both. Of a line that an earlier pass has too, the rest
is kept.
"""

from collections.abc import Hashable, Mapping, Sequence

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.assignment import assign_one_to_one
from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_row, numbered
from mlsroad_pipeline.algorithms.inventory.objects.merging import MergedObjects
from mlsroad_pipeline.algorithms.inventory.objects.table import OBJECT_FIELDS

SAME_OBJECT = {"pole": 0.5, "sign": 0.5, "tree": 1.0, "vehicle": 1.5}
"""Kind to the largest distance in plan of the places of one object in two passes, metres."""

SAME_LINE = {"kerb": 0.5, "wire": 0.3, "barrier": 0.5}
OTHER_LINE = 0.25
"""Largest distance in plan of one line in two passes, metres; `OTHER_LINE` is that of markings."""

LEAST_REST = 1.0
"""Shortest rest of a line that is listed, metres."""

FAR = 10_000.0
"""Least absolute coordinate of an object by which the places of several passes are taken for comparable, metres."""


def are_comparable(tables: Sequence[pd.DataFrame]) -> bool:
    """Return whether the places of objects are those of one reference system, and not of a scanner each."""
    places = np.concatenate([table[["x", "y"]].to_numpy(np.float64) for table in tables])
    return bool((np.abs(places).max(axis=1) >= FAR).all()) if len(places) else False


def join_pass_objects(passes: Sequence[MergedObjects], *, comparable: bool) -> MergedObjects:
    """Join the objects of several passes."""
    joined = passes[0].objects
    numbers = dict(passes[0].numbers)
    none = np.zeros(0, np.int64)
    for one_pass in passes[1:]:
        own = one_pass.objects
        first, second = _pairs(joined, own) if comparable else (none, none)
        new = np.setdiff1d(np.arange(len(own)), second)
        number = np.zeros(1 + len(own), np.uint32)
        number[own["object_id"].to_numpy()[second]] = joined["object_id"].to_numpy()[first]
        number[own["object_id"].to_numpy()[new]] = len(joined) + 1 + np.arange(len(new))
        own = own.assign(object_id=number[own["object_id"]], pole_id=number[own["pole_id"]])
        merged = _merged(joined.iloc[first], own.iloc[second]) if len(first) else own.iloc[:0]
        rest = joined[~joined["object_id"].isin(merged["object_id"])]
        filled = [table for table in (rest, merged, own.iloc[new]) if len(table)]
        if filled:
            joined = pd.concat(filled, ignore_index=True).sort_values("object_id", kind="stable", ignore_index=True)
        numbers |= {scene: number[parts] for scene, parts in one_pass.numbers.items()}
    return MergedObjects(joined[list(OBJECT_FIELDS)].astype(OBJECT_FIELDS), numbers)


def _pairs(first: pd.DataFrame, second: pd.DataFrame) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows of two tables that are one object."""
    rows = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for kind, reach in SAME_OBJECT.items():
        mine, other = (np.flatnonzero((table["kind"] == kind).to_numpy()) for table in (first, second))
        here, there = (table[["x", "y"]].to_numpy(np.float64)[own] for table, own in ((first, mine), (second, other)))
        a, b = assign_one_to_one(here, there, reach)
        rows[0].append(mine[a])
        rows[1].append(other[b])
    return np.concatenate(rows[0]), np.concatenate(rows[1])


def _merged(first: pd.DataFrame, second: pd.DataFrame) -> pd.DataFrame:
    """Return one row for each pair of rows, which are objects of the first table with new numbers."""
    a, b = first.reset_index(drop=True), second.reset_index(drop=True)
    points = a["point_count"] + b["point_count"]
    areas = [shapely.from_wkt(t["footprint"].replace("", "POLYGON EMPTY").to_numpy()) for t in (a, b)]
    hulls = shapely.convex_hull(shapely.union(*areas))
    share = (a["disagreeing_share"] * a["point_count"] + b["disagreeing_share"] * b["point_count"]) / points
    return a.where(a["score"] >= b["score"], b).assign(
        object_id=a["object_id"],
        pole_id=a["pole_id"].where(a["pole_id"] > 0, b["pole_id"]),
        point_count=points,
        disagreeing_share=share.round(4),
        footprint=np.where(shapely.is_empty(hulls), "", shapely.to_wkt(hulls, rounding_precision=3)),
        **{name: np.minimum(a[name], b[name]) for name in ("x_min", "y_min", "z_min")},
        **{name: np.maximum(a[name], b[name]) for name in ("x_max", "y_max", "z_max")},
    )


def join_pass_lines(passes: Sequence[pd.DataFrame], *, comparable: bool) -> pd.DataFrame:
    """Join the lines of several passes."""
    if not comparable:
        return numbered(passes)
    kept = [passes[0]]
    for table in passes[1:]:
        before = pd.concat([own for own in kept if len(own)], ignore_index=True) if any(map(len, kept)) else passes[0]
        kept += [_rest(own, before[before["kind"] == kind]) for kind, own in table.groupby("kind", sort=True)]
    return numbered(kept)


def _rest(own: pd.DataFrame, before: pd.DataFrame) -> pd.DataFrame:
    """Return the lines of one kind without what lies beside lines of earlier passes."""
    reach = SAME_LINE.get(str(own["kind"].iloc[0]), OTHER_LINE)
    lines = shapely.from_wkt(own["line"].to_numpy())
    known = shapely.from_wkt(before["line"].to_numpy())
    tree = shapely.STRtree(known)
    rows: list[Mapping[Hashable, object]] = []
    for line, row in zip(lines, own.to_dict("records"), strict=True):
        near = tree.query(line, predicate="dwithin", distance=reach)
        if not len(near):
            rows.append(row)
            continue
        rest = shapely.difference(line, shapely.union_all(shapely.buffer(known[near], reach)))
        pieces = [part for part in shapely.get_parts(rest) if part.length >= LEAST_REST]
        rows += [_piece(row, part) for part in pieces]
    return pd.DataFrame(rows, columns=list(own.columns))


def _piece(row: Mapping[Hashable, object], line: shapely.LineString) -> dict[Hashable, object]:
    """Return the row of a part of a line; its stations are unknown."""
    place = line_row(str(row["kind"]), shapely.get_coordinates(line, include_z=True), None)
    changed = ("length", "x", "y", "line", "from_station", "to_station", "offset")
    return {**row, **{name: place[name] for name in changed}}
