"""Lines of two surveys, compared by their inventories and by the points of both."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.inventory.changes import lines as of_lines
from mlsroad_pipeline.algorithms.inventory.changes.lines import (
    LinePart,
    Lines,
    compare_lines,
    length_of,
    places_on,
    with_evidence,
)
from mlsroad_pipeline.inventory_files.road_inventory import line_vertices
from mlsroad_pipeline.label.labelled_clouds import LabelledCloud, Recorded

COLUMNS = ("kind", "state", "length", "first_id", "second_id", "x", "y", "reason")
"""Columns of the parts of lines; `x` and `y` are of their middle."""
_DEFAULT_WIDTH = 0.15  # of a marking whose width is not known, metres
_REACH = of_lines.ASIDE + of_lines.ALONG


class ComparedLines(NamedTuple):
    """Parts of lines with their states, and their shapes."""

    table: pd.DataFrame
    shapes: NDArray[np.object_]


class _Surroundings(NamedTuple):
    """Points of a survey around the lines that one of both lists."""

    xyz: NDArray[np.float64]
    is_ground: NDArray[np.bool_]
    intensity: NDArray[np.float32]
    tree: cKDTree
    wires: NDArray[np.float64]  # Places on the wires of the survey

    def of(self, places: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the rows of the points near places."""
        lists = self.tree.query_ball_point(places[:, :2], _REACH)
        return np.unique(np.concatenate([np.asarray(rows, dtype=np.int64) for rows in lists]))


def compared_lines(first: Recorded, second: Recorded) -> ComparedLines:
    """Return the states of the lines of two surveys in one reference system."""
    tables = [_lines_of(survey) for survey in (first, second)]
    lines = [Lines(table["kind"].tolist(), vertices) for table, vertices in tables]
    parts = compare_lines(*lines)
    alone = [part.places for part in parts if not part.state]
    around = [_surroundings(survey.clouds, alone, own) for survey, own in zip((first, second), lines, strict=True)]
    for k, part in enumerate(parts):
        if not part.state:
            own, other = around if part.second < 0 else around[::-1]
            number = part.first if part.second < 0 else part.second
            width = float(tables[part.second >= 0][0]["width"].iloc[number])
            found = _evidence(part, own, other, width if np.isfinite(width) else _DEFAULT_WIDTH)
            parts[k] = with_evidence(part, found)
    numbers = [np.append(table["line_id"].to_numpy(dtype=np.int64), 0) for table, _ in tables]  # -1: no line
    rows = []
    for part in parts:
        x, y = part.places[len(part.places) // 2, :2]
        ids = int(numbers[0][part.first]), int(numbers[1][part.second])
        rows.append(
            (part.kind, part.state, round(length_of(part.places), 2), *ids, x.round(3), y.round(3), part.reason)
        )
    shapes = np.array([shapely.LineString(part.places) for part in parts], dtype=object)
    return ComparedLines(pd.DataFrame(rows, columns=list(COLUMNS)), shapes)


def length_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return the length of each kind by state, metres."""
    found = table.pivot_table(index="kind", columns="state", values="length", aggfunc="sum", fill_value=0.0)
    return found.round(1).reset_index().rename_axis(columns=None)


def _lines_of(survey: Recorded) -> tuple[pd.DataFrame, list[NDArray[np.float64]]]:
    table = survey.inventory.lines
    if table is None:
        table = pd.DataFrame({"line_id": [], "kind": [], "width": []})
        return table, []
    move = survey.clouds[0].move if survey.clouds else None
    vertices = line_vertices(table)
    return table, vertices if move is None else [move(own) for own in vertices]


def _surroundings(clouds: Sequence[LabelledCloud], places: Sequence[NDArray[np.float64]], own: Lines) -> _Surroundings:
    every = np.concatenate([np.zeros((0, 3)), *places])
    parts = [(np.zeros((0, 3)), np.zeros(0, np.bool_), np.zeros(0, np.float32))]
    for cloud in clouds if len(every) else ():
        xyz, code, intensity = cloud.near(every, _REACH)
        parts.append((xyz, cloud.is_ground[code], intensity))
    xyz, is_ground, intensity = (np.concatenate(column) for column in zip(*parts, strict=True))
    wires = [places_on(v) for kind, v in zip(own.kind, own.vertices, strict=True) if kind == "wire"]
    return _Surroundings(xyz, is_ground, intensity, cKDTree(xyz[:, :2]), np.concatenate([np.zeros((0, 3)), *wires]))


def _evidence(part: LinePart, own: _Surroundings, other: _Surroundings, width: float) -> str:
    """Return what the points of the other survey show of a part of a line."""
    kind, places = part.kind, part.places
    if kind == "wire":
        rows = other.of(places)
        met = np.zeros(len(places), dtype=np.bool_)
        if len(rows):
            distance, _ = cKDTree(other.xyz[rows]).query(places, distance_upper_bound=of_lines.WIRE_NEAR)
            met = np.isfinite(distance)
        if met.mean() > of_lines.STILL_THERE:
            return of_lines.SHOWN
        # Rays into the sky have no points: only another wire proves that wires were seen here.
        seen = len(other.wires) and cKDTree(other.wires[:, :2]).query(places[:, :2])[0].max() <= of_lines.OTHER_WIRE
        return of_lines.ABSENT if seen else of_lines.UNSEEN
    if kind == "barrier":
        rows = other.of(places)
        return of_lines.barrier_seen(other.xyz[rows], other.is_ground[rows], places)
    measures = []
    for around in (own, other):
        rows = around.of(places)
        rows = rows[around.is_ground[rows]]
        measures.append(
            of_lines.step_across(around.xyz[rows], places)
            if kind == "kerb"
            else of_lines.contrast_of(around.xyz[rows], around.intensity[rows], places, width)
        )
    return of_lines.same_measure(
        measures[0], measures[1], of_lines.LEAST_STEP if kind == "kerb" else of_lines.LEAST_CONTRAST
    )
