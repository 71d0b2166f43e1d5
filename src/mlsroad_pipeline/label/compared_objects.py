"""Objects of two surveys, compared by their inventories and by the points and rays of both."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.geometry.thinning import first_in_cells
from mlsroad_pipeline.algorithms.inventory.changes.measures import (
    AROUND,
    growth_of_crown,
    panel_in_both,
    rays_through_panel,
    turn_of_axis,
)
from mlsroad_pipeline.algorithms.inventory.changes.objects import (
    MeasuredByPoints,
    Unmatched,
    changed_objects,
    listed_changes,
    pair_objects,
)
from mlsroad_pipeline.algorithms.inventory.register.states import evidence_of
from mlsroad_pipeline.label.labelled_clouds import LabelledCloud, Recorded, on_ground, seen_space

STANDING_CELL = 0.2
"""Distance of points in two surveys that belong to one surface, metres."""
PANEL_RANGE = 80.0
"""Distance from the scanner up to which rays through panels are counted, metres."""


def compared_objects(first: Recorded, second: Recorded) -> pd.DataFrame:
    """Return the states of all poles, signs and trees of two surveys in one reference system."""
    before, after = first.objects, second.objects
    pairs = pair_objects(before, after)
    doubtful = pairs.doubtful(before, after)
    of_first = _evidence(before, doubtful.left_first, first.clouds, second.clouds)
    of_second = _evidence(after, doubtful.left_second, second.clouds, first.clouds)
    pairs = pairs.proved(of_first, of_second)
    listed = np.flatnonzero(listed_changes(before, after, pairs))
    measured = MeasuredByPoints.unknown(len(pairs.first))
    of_pairs = _measured(
        before.iloc[pairs.first[listed]], after.iloc[pairs.second[listed]], first.clouds, second.clouds
    )
    for column, own in zip(measured, of_pairs, strict=True):
        column[listed] = own
    return changed_objects(before, after, pairs, of_first, of_second, measured)


def _measured(
    before: pd.DataFrame, after: pd.DataFrame, first: Sequence[LabelledCloud], second: Sequence[LabelledCloud]
) -> MeasuredByPoints:
    """Return the changes of the measures of pairs by the points around their axes."""
    found = MeasuredByPoints.unknown(len(after))
    near = [points_around(table, clouds) for table, clouds in ((before, first), (after, second))]
    for k in range(len(after)):
        one, two, points = before.iloc[k], after.iloc[k], (near[0][k], near[1][k])
        if two["kind"] == "pole":
            found.turn[k] = turn_of_axis(*points, one, two)
        elif two["kind"] == "tree":
            middle = float(min(one["z"] + one["height"] / 2, two["z"] + two["height"] / 2))
            found.growth[k] = growth_of_crown(*points, middle)
        else:
            low = (float(one["z"] + one["panel_bottom"]), float(two["z"] + two["panel_bottom"]))
            found.panel[k] = panel_in_both(*points, low)
    return found


def points_around(objects: pd.DataFrame, clouds: Sequence[LabelledCloud]) -> list[NDArray[np.float64]]:
    """Return the points near the axis of each object."""
    places, kinds = objects[["x", "y"]].to_numpy(dtype=np.float64), objects["kind"].tolist()
    parts: list[list[NDArray[np.float64]]] = [[np.zeros((0, 3))] for _ in kinds]
    for cloud in clouds if kinds else ():
        for xyz, _, _ in cloud.chunks():
            rows = cKDTree(xyz[:, :2]).query_ball_point(places, [AROUND[kind] for kind in kinds])
            for own, near in zip(parts, rows, strict=True):
                own.append(xyz[near])
    return [np.concatenate(own) for own in parts]


class OwnPoints(NamedTuple):
    """Points of some objects, thinned to `STANDING_CELL`, and the row of the object of each."""

    xyz: NDArray[np.float64]
    owner: NDArray[np.int64]


def _own_points(numbers: NDArray[np.int64], clouds: Sequence[LabelledCloud]) -> OwnPoints:
    parts = [part for cloud in clouds for part in cloud.points_of(numbers)] if len(numbers) else []
    xyz, owner = (
        np.concatenate(column) for column in zip((np.zeros((0, 3)), np.zeros(0, np.int64)), *parts, strict=True)
    )
    rows = [rows[first_in_cells(xyz[rows], STANDING_CELL)] for rows in map(np.flatnonzero, _each(owner, len(numbers)))]
    kept = np.concatenate([np.zeros(0, np.int64), *rows])
    return OwnPoints(xyz[kept], owner[kept])


def _standing_shares(n: int, own: OwnPoints, others: Sequence[LabelledCloud]) -> NDArray[np.float64]:
    """Return the share of the points of `n` objects that have points of the other survey within `STANDING_CELL`.

    Objects without points of their own, such as those that a user added, have NaN.
    """
    share = np.full(n, np.nan)
    if not len(own.xyz):
        return share
    met, tree = np.zeros(len(own.xyz), dtype=np.bool_), cKDTree(own.xyz)
    for cloud in others:
        for points, _, _ in cloud.chunks():
            near = points[np.isfinite(tree.query(points, distance_upper_bound=STANDING_CELL)[0])]
            if len(near):
                met |= np.isfinite(cKDTree(near).query(own.xyz, distance_upper_bound=STANDING_CELL)[0])
    count = np.bincount(own.owner, minlength=n)
    share[count > 0] = np.bincount(own.owner, met, minlength=n)[count > 0] / count[count > 0]
    return share


def _crossing(kind: NDArray[np.str_], own: OwnPoints, others: Sequence[LabelledCloud]) -> NDArray[np.float64]:
    """Return the rays of the other survey through the panels of signs; NaN of other kinds and without own points."""
    crossing = np.full(len(kind), np.nan)
    rows = [row for row in np.flatnonzero(kind == "sign").tolist() if (own.owner == row).any()]
    crossing[rows] = 0
    for cloud in others if rows else ():
        for points, _, scanner in cloud.chunks():
            low, high = scanner.min(axis=0) - PANEL_RANGE, scanner.max(axis=0) + PANEL_RANGE
            for row in rows:
                panel = own.xyz[own.owner == row]
                if (panel[0] >= low).all() and (panel[0] <= high).all():
                    crossing[row] += rays_through_panel(panel, scanner, points)
    return crossing


def _each(owner: NDArray[np.int64], n: int) -> Iterator[NDArray[np.bool_]]:
    return (owner == k for k in range(n))


def _evidence(
    objects: pd.DataFrame, rows: NDArray[np.int64], own: Sequence[LabelledCloud], clouds: Sequence[LabelledCloud]
) -> Unmatched:
    """Return what the other survey has seen at the places of objects.

    Places without ground there have the base of the object; those without either are left out.
    """
    places = on_ground(objects[["x", "y"]].to_numpy(dtype=np.float64)[rows], clouds)
    places[:, 2] = np.where(np.isnan(places[:, 2]), objects["z"].to_numpy(dtype=np.float64)[rows], places[:, 2])
    known = np.isfinite(places[:, 2])
    rows, places = rows[known], places[known]
    kind = objects["kind"].to_numpy(dtype=str)[rows]
    seen = seen_space(places, kind, clouds)
    evidence = evidence_of(seen, kind, objects["height"].to_numpy(dtype=np.float64)[rows])
    points = _own_points(objects["object_id"].to_numpy(dtype=np.int64)[rows], own)
    standing, crossing = _standing_shares(len(rows), points, clouds), _crossing(kind, points, clouds)
    return Unmatched(rows, evidence, standing, seen.rays, crossing)
