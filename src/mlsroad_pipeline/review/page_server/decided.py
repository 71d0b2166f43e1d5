"""Survey after all decisions, for the page: changed and new objects, classes of points and their counts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.lines.extraction import LINE_FIELDS
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
from mlsroad_pipeline.review.corrections.line_decisions import line_states
from mlsroad_pipeline.review.corrections.listed_objects import ListedObjects
from mlsroad_pipeline.review.corrections.states import States
from mlsroad_pipeline.review.delivery.corrected_objects import changed_rows, kind_of, kinds_of_classes
from mlsroad_pipeline.review.delivery.corrected_points import ClassCodes, object_codes
from mlsroad_pipeline.review.page_server.cloud_files import CloudFiles
from mlsroad_pipeline.review.page_server.output_folder import OutputFolder
from mlsroad_pipeline.review.page_server.selection import Near
from mlsroad_pipeline.review.page_server.tile_format import TileIndex
from mlsroad_pipeline.review.painted import Painted

Box = tuple[NDArray[np.float64], NDArray[np.float64]]

_SLACK = 0.05  # of the box of an object, metres: its points were rounded


class ClassCounts:
    """Counts of the classes in force; what was read once is kept."""

    def __init__(
        self, tiles: TileIndex, counts: Mapping[str, int], clouds: CloudFiles, box_of: Callable[[int], Box]
    ) -> None:
        self._tiles, self._clouds, self._box_of = tiles, clouds, box_of
        self._labelled = np.zeros(256, np.int64)
        for code, count in counts.items():
            self._labelled[int(code)] = count
        self._known: tuple[NDArray[np.uint32], NDArray[np.uint8]] = np.empty(0, np.uint32), np.empty(0, np.uint8)
        self._objects: dict[int, tuple[NDArray[np.uint32], NDArray[np.int64]]] = {}

    def know(self, points: Near) -> None:
        """Keep the classes of points as labelled, which need not be read again."""
        rows, first = np.unique(np.concatenate([self._known[0], points.rows]), return_index=True)
        self._known = rows, np.concatenate([self._known[1], points.labelled])[first]

    def now(self, painted: Painted) -> dict[str, int]:
        """Return the number of points of each class in force, by code."""
        counts, below = self._labelled.copy(), self._codes(painted.rows).copy()  # `below`: classes under the strokes
        changed = np.flatnonzero(painted.of_objects >= 0).tolist()
        self._read([number for number in changed if number not in self._objects])
        for number in changed:
            rows, labelled = self._objects[number]
            counts -= labelled
            counts[painted.of_objects[number]] += len(rows)
            if len(below):
                below[np.isin(painted.rows, rows)] = painted.of_objects[number]
        counts += np.bincount(painted.codes, minlength=256) - np.bincount(below, minlength=256)
        return {str(code): int(counts[code]) for code in np.flatnonzero(counts)}

    def _read(self, numbers: list[int]) -> None:
        """Keep the rows of the points of objects, and their number per class as labelled; a node is read once."""
        near = [self._tiles.touching(low - _SLACK, high + _SLACK) for low, high in map(self._box_of, numbers)]
        parts = [np.empty((0, 3), np.uint32)]
        for node in np.unique(np.concatenate(near)).tolist() if near else ():
            chunk = self._tiles.chunk(node)
            own = np.isin(chunk.objects, numbers)
            parts.append(np.column_stack([chunk.objects[own], chunk.rows[own], chunk.codes[own, 0]]))
        points = np.concatenate(parts)
        points = points[np.argsort(points[:, 0], kind="stable")]
        ends = (np.searchsorted(points[:, 0], numbers, side=side).tolist() for side in ("left", "right"))
        for number, first, last in zip(numbers, *ends, strict=True):
            self._objects[number] = points[first:last, 1], np.bincount(points[first:last, 2], minlength=256)

    def _codes(self, rows: NDArray[np.uint32]) -> NDArray[np.uint8]:
        """Return the classes of ascending rows as labelled; those that no stroke of this page selected are read."""
        known, codes = self._known
        missing = np.setdiff1d(rows, known, assume_unique=True)
        if len(missing):
            none = np.zeros(len(missing), np.uint32)
            read = self._clouds.codes(missing)
            self.know(Near(np.empty((len(missing), 3), np.float32), missing, read, read, none))
            known, codes = self._known
        return codes[np.searchsorted(known, rows)]


_PLACED = {"x", "merged", "bases"}
"""Entries of states of objects with another place or outline; accepted and rejected ones have the rows of before."""


class Decided:
    """An inventory with decisions, as the page shows it."""

    def __init__(self, output: OutputFolder, listed: ListedObjects) -> None:
        self._output, self._table = output, listed.table
        self._kinds = kinds_of_classes(LabelledOutput(output.path, {"settings": {}, **output.run}).schemes)
        self._counts: ClassCounts | None = None

    @cached_property
    def _codes(self) -> ClassCodes:
        return ClassCodes(self._output)

    @cached_property
    def _outlines(self) -> dict[str, list[list[float]]]:
        return self._output.footprints()

    def states(self, states: States) -> dict[str, dict[str, Any]]:
        """Return the states of objects by number, with the kind that each has now; empty for no object."""
        kind = dict(zip(self._table["object_id"].tolist(), self._table["kind"].astype(str), strict=True))
        return {
            str(number): {**state, "checked_kind": kind_of(state, kind[number], self._kinds)}
            for number, state in states.of_objects.items()
        }

    def objects(self, states: States) -> list[dict[str, Any]]:
        """Return the rows of changed and new objects as JSON values."""
        numbers = {
            n for n, state in states.of_objects.items() if state["status"] == "changed" or _PLACED & state.keys()
        }
        numbers |= {other for n in numbers for other in states.of_objects[n].get("merged", ())}
        chosen = self._table[self._table["object_id"].isin(numbers)]
        rings = [self._outlines.get(str(number), []) for number in chosen["object_id"]]
        texts = [f"POLYGON (({', '.join(f'{x} {y}' for x, y in ring)}))" if ring else "" for ring in rings]
        last = int(self._table["object_id"].max()) if len(self._table) else 0
        rows = changed_rows(chosen.assign(footprint=texts), states, kinds=self._kinds, last=last)
        return [{name: _plain(value) for name, value in row.items() if name != "footprint"} for row in rows]

    def lines(self, states: States) -> dict[str, Any]:
        """Return the status of decided lines by number, the rows of changed and new ones, and those that are gone."""
        vertices, table, path = self._lines
        found = line_states(states.lines, table, path)
        rows = [
            {name: _plain(value) for name, value in row.items() if name != "line"}
            | {"vertices": _vertices_of(row["line"]) if row["line"] else vertices[number]}
            for number, row in found.rows.items()
        ]
        status = {str(number): text for number, text in found.status.items()}
        return {"status": status, "rows": rows, "gone": sorted(found.gone)}

    @cached_property
    def _lines(self) -> tuple[dict[int, Any], pd.DataFrame, Trajectory | None]:
        lines, path = self._output.lines(), np.array(self._output.path_vertices()).reshape(-1, 3)
        types = {name: field.dtype for name, field in LINE_FIELDS.items()}
        rows = [
            {n: line.get(n) or "" if dtype == "str" else line.get(n) for n, dtype in types.items()} for line in lines
        ]
        table = pd.DataFrame(rows, columns=list(types)).astype(types)
        trajectory = Trajectory.from_positions(path, check_jumps=False) if len(path) > 1 else None
        return {line["line_id"]: line["vertices"] for line in lines}, table, trajectory

    def in_force(self, states: States, strokes: Iterator[tuple[NDArray[np.int64], str]]) -> Painted:
        """Return the classes that decisions give to points."""
        of_objects, _ = object_codes(self._table, states, self._codes)
        named = ((rows, self._codes.code(name)) for rows, name in strokes)
        return Painted.of(((rows, code) for rows, code in named if code is not None), of_objects)

    def counts(self, tiles: TileIndex | None, painted: Painted) -> dict[str, int] | None:
        """Return the number of points per class code; None while the tiles are not finished."""
        if tiles is None:
            return None
        return self.counted(tiles).now(painted)

    def counted(self, tiles: TileIndex) -> ClassCounts:
        """Return the counts of the classes, which keep what they have read."""
        if self._counts is None:
            self._counts = ClassCounts(tiles, tiles.class_counts(), self._output.clouds, self._box_of)
        return self._counts

    def _box_of(self, number: int) -> Box:
        """Return the box of the points of an object in local coordinates; all of the survey where it is unknown."""
        row = self._table[self._table["object_id"] == number].iloc[0]
        low, high = (
            np.array([row.get(f"{axis}_{end}", np.nan) for axis in "xyz"], np.float64) - self._output.clouds.origin
            for end in ("min", "max")
        )
        return np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)


def _vertices_of(text: str) -> list[list[float]]:
    found: list[list[float]] = shapely.get_coordinates(shapely.from_wkt(text), include_z=True).tolist()
    return found


def _plain(value: Any) -> Any:
    """Return a value of a table as JSON: None in place of missing ones."""
    if isinstance(value, str | bool):
        return value
    if value is None or pd.isna(value):
        return None
    return value.item() if isinstance(value, np.generic) else value
