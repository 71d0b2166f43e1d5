"""Files, passes and scanners that saw each object of the inventory, and when.

Two points of a place are of different passes if more than `PASS_GAP` seconds lie between their times and no point of
the place has a time in between. Without times a pass is a value of `route`, the point source id of LAS, or a file.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.geometry.sorting import rank_integers
from mlsroad_pipeline.algorithms.inventory.objects.table import SEEN_BY, empty_table
from mlsroad_pipeline.algorithms.scenes.weeks import WEEK, dates_of, falls_at_week_end

PASS_GAP = 30.0
"""Shortest time without points of a place between two passes, seconds."""

SECOND, SCANNER, ROUTE, SOURCE = "second", "scanner", "route", "source"
"""Columns of a scene: whole seconds of the time, number of the scanner, number of the route, point source id of points
with time."""

NO_TIME = np.iinfo(np.int32).min
"""Value of `SECOND` for points whose time is not finite or has no 32 bits."""

SIGHTING_FIELDS = {
    "part": "int32",
    "file": "int32",
    "scanner": "int32",
    "route": "int32",
    "visit": "int32",
    "first": "float64",
    "last": "float64",
}
"""Columns of a table of sightings: the object as in `SceneObjects.part` (0: the whole core), file and scanner (-1
unknown), route (of points without time; -1 for others), number of the pass in the scene, first and last time of that
pass, seconds (NaN unknown)."""


_KIND = ("file", "scanner", "route", "visit")


class Sightings(NamedTuple):
    """Sightings of a scene."""

    scene: str  # The scene's id
    table: pd.DataFrame  # Columns of `SIGHTING_FIELDS`


def visit_columns(cloud: PointCloud) -> dict[str, NDArray[np.int32]]:
    """Return the columns of a cloud that distinguish its passes and scanners."""
    columns = {}
    if "gps_time" in cloud and cloud["gps_time"].any():
        time = np.floor(cloud["gps_time"].astype(np.float64))
        known = np.isfinite(time) & (np.abs(time) < np.iinfo(np.int32).max)
        columns[SECOND] = np.where(known, time, NO_TIME).astype(np.int32)
    if "point_source_id" in cloud:
        columns[SOURCE if SECOND in columns else ROUTE] = cloud["point_source_id"].astype(np.int32)
    scanner = next((name for name in ("scanner", "scanner_channel") if name in cloud), None)
    if scanner is not None:
        columns[SCANNER] = cloud[scanner].astype(np.int32)
    return columns


def time_passes(second: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the pass of each point: numbers from 0 in the order of time; points without time are of the first."""
    known = second[second != NO_TIME]
    if not len(known):
        return np.zeros(len(second), dtype=np.int64)
    if falls_at_week_end(known):
        second = np.where((second != NO_TIME) & (second < WEEK / 2), second + np.int32(WEEK), second)
        known = second[second != NO_TIME]
    low, n_seconds = int(known.min()), int(known.max()) - int(known.min()) + 1
    if n_seconds <= 4 * len(known) + 1000:  # counting is faster than sorting
        times = low + np.flatnonzero(np.bincount(known.astype(np.int64) - low, minlength=n_seconds))
    else:
        times = np.unique(known).astype(np.int64)
    starts = times[np.flatnonzero(np.diff(times) > PASS_GAP) + 1]
    return np.searchsorted(starts, second, side="right")


def sightings_of_scene(part: NDArray[np.int32], scene: PointCloud, core: NDArray[np.bool_]) -> pd.DataFrame:
    """Return which files, scanners and passes saw each object of a scene."""
    if not len(part):
        return empty_table(SIGHTING_FIELDS)
    unknown = np.full(len(part), -1, dtype=np.int32)
    file, scanner = scene["file"][core], scene[SCANNER][core] if SCANNER in scene else unknown
    route = scene[ROUTE][core] if ROUTE in scene else unknown
    second = scene[SECOND][core] if SECOND in scene else None
    visit = np.zeros(len(part), dtype=np.int64) if second is None else time_passes(second)
    kinds, kind = _distinct(file, scanner, route, visit)
    own = np.flatnonzero(part)
    tables = []
    for of, rows in ((np.zeros(1, dtype=np.int64), slice(None)), (part[own].astype(np.int64), own)):
        low = int(of.min(initial=0))
        found, rank = rank_integers((of - low) * len(kinds) + kind[rows])
        first, last = _ends(None if second is None else second[rows], rank, len(found))
        columns = dict(zip(_KIND, kinds[found % len(kinds)].T, strict=True))
        tables.append(pd.DataFrame({"part": found // len(kinds) + low, **columns, "first": first, "last": last}))
    return pd.concat(tables, ignore_index=True).astype(SIGHTING_FIELDS)


def _distinct(*columns: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the distinct rows of columns of few values, and the number of each row."""
    number, rows = np.zeros(len(columns[0]), dtype=np.int64), np.zeros((1, 0), dtype=np.int64)
    for column in columns:
        if (column == column[0]).all():
            rows = np.column_stack([rows, np.full(len(rows), column[0])])
            continue
        values, rank = rank_integers(column)
        present, number = rank_integers(number * len(values) + rank)
        rows = np.column_stack([rows[present // len(values)], values[present % len(values)]])
    return rows, number


def _ends(second: NDArray[np.int32] | None, group: NDArray[np.int64], n_groups: int) -> NDArray[np.float64]:
    """Return the first and the last known time of each group, NaN without one."""
    first, last = np.full(n_groups, np.iinfo(np.int32).max, np.int32), np.full(n_groups, NO_TIME, np.int32)
    if second is not None:
        np.maximum.at(last, group, second)
        known = second != NO_TIME
        np.minimum.at(first, group if known.all() else group[known], second if known.all() else second[known])
    return np.where(last == NO_TIME, np.nan, [first, last])


def with_sightings(
    objects: pd.DataFrame, numbers: Mapping[str, NDArray[np.uint32]], sightings: Iterable[Sightings]
) -> pd.DataFrame:
    """Add the files, passes and scanners that saw the objects, and the times."""
    own, there = [], []
    for scene, table in sightings:
        number = numbers[scene][table["part"].to_numpy()].astype(np.int64)
        mine = table.assign(object=number)[number > 0].groupby(["object", *_KIND], as_index=False)
        own.append(mine.agg({"first": "min", "last": "max"}))
        whole = table[table["part"] == 0].drop(columns="part")
        there.append(own[-1][["object"]].drop_duplicates().merge(whole, how="cross"))
    if not own or not len(objects):
        return objects
    seen, near = pd.concat(own, ignore_index=True), pd.concat(there, ignore_index=True)
    n = len(objects)
    counts = (
        _distinct_of(seen, ["file"], n),
        _n_passes(seen, n),
        _n_passes(near, n),
        _distinct_of(seen[seen["scanner"] >= 0], ["scanner"], n),
        _distinct_of(near[near["scanner"] >= 0], ["scanner"], n),
    )
    times = seen.groupby("object").agg({"first": "min", "last": "max"}).reindex(range(1, n + 1))
    return objects.assign(
        **dict(zip(SEEN_BY, counts, strict=True)),
        first_time=times["first"].to_numpy(),
        first_date=dates_of(times["first"].to_numpy(np.float64)),
        last_time=times["last"].to_numpy(),
    )


_NEAR, _OTHERS = 25.0, 3  # distance of objects that show how long a place was seen, metres, and their least number
_LONG, _SHARE = (
    3.0,
    1 / 3,
)  # least time of a place, s, or least number of its files, and share of it of a moving vehicle


def mark_moving(objects: pd.DataFrame) -> pd.DataFrame:
    """Add the motion of vehicles: ``moving`` for those seen much more briefly than poles, signs and trees around them.

    A rotating scanner sees what stands for seconds; a line scanner sees it for less than one, which decides nothing.
    Without times the files count, such as the frames of a drive.
    """
    standing, driving = ("pole", "sign", "tree"), ("vehicle",)
    static, vehicle = (np.flatnonzero(objects["kind"].isin(kinds)) for kinds in (standing, driving))
    moving = np.zeros(len(objects), dtype=bool)
    if len(static) >= _OTHERS and len(vehicle):
        span = (objects["last_time"] - objects["first_time"]).to_numpy(np.float64)
        seen = np.where(np.isnan(span), objects["file_count"].to_numpy(np.float64), span)
        where = objects[["x", "y"]].to_numpy(np.float64)
        near = cKDTree(where[static]).query_ball_point(where[vehicle], _NEAR)
        for row, others in zip(vehicle, near, strict=True):
            alike = seen[static[others]][np.isnan(span[static[others]]) == np.isnan(span[row])]
            usual = float(np.median(alike)) if len(alike) >= _OTHERS else 0.0
            moving[row] = usual >= _LONG and seen[row] <= _SHARE * usual
    return objects.assign(motion=np.where(moving, "moving", ""))


def _distinct_of(table: pd.DataFrame, columns: list[str], n_objects: int) -> NDArray[np.int64]:
    """Return the number of distinct values of columns per object."""
    distinct = table[["object", *columns]].drop_duplicates()
    return np.bincount(distinct["object"].to_numpy(), minlength=n_objects + 1)[1 : n_objects + 1]


def _n_passes(table: pd.DataFrame, n_objects: int) -> NDArray[np.int64]:
    """Return the number of passes per object: intervals of time apart; without any time, routes or files."""
    timed = table["first"].notna()
    rows = table[timed].sort_values(["object", "first"], kind="stable")
    until = rows.groupby("object")["last"].cummax().shift(fill_value=-np.inf).to_numpy()
    number = rows["object"].to_numpy()
    new = (np.diff(number, prepend=0) != 0) | (rows["first"].to_numpy() > until + PASS_GAP)
    counts = np.bincount(number[new], minlength=n_objects + 1)[1 : n_objects + 1]
    untimed = table[~timed & ~table["object"].isin(number)]
    by_route = untimed["route"] > 0
    counts = counts + _distinct_of(untimed[by_route], ["route"], n_objects)
    return counts + _distinct_of(untimed[~by_route], ["file"], n_objects)
