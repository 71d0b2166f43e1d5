"""Formats whose files are tables of scalar columns: description, reading by ranges, origin."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import FileInfo, PointFormat, ReadOptions
from mlsroad_pipeline.formats.column_names import resolve_columns
from mlsroad_pipeline.formats.content import open_content
from mlsroad_pipeline.formats.crs_units import auto_note, with_units
from mlsroad_pipeline.formats.files import FileKey, check_file, clip_range, file_key
from mlsroad_pipeline.formats.flat_table import flat_cloud
from mlsroad_pipeline.formats.precision import StoredCoordinates, step_note
from mlsroad_pipeline.formats.standard_columns import COORDINATES

logger = logging.getLogger(__name__)

CHUNK = 1_000_000
LEAST_RECORDS = 100
"""Smallest number of points whose bytes are compared with the length of a file."""

COMPARED = 1 << 16
"""Least number of bytes whose repetition shows the size of a record."""

_EXTREMES: dict[tuple[FileKey, tuple[str, ...], tuple[object, ...]], tuple[float, float]] = {}
"""Minima and maxima of columns of a file under given options."""


@dataclass(frozen=True)
class PointTable:
    """An open file as a table."""

    names: tuple[str, ...]  # columns, each with one value per point
    n_points: int
    rows: Callable[[Sequence[str], int, int], Mapping[str, NDArray]]  # columns of rows start to stop, as stored
    crs: str | None = None  # CRS as WKT
    details: Mapping[str, Any] = field(default_factory=dict)  # content of `FileInfo.details`
    notes: tuple[str, ...] = ()  # one sentence per repair of the reader
    guess: Mapping[str, Any] = field(default_factory=dict)  # `ReadOptions.columns` of unnamed columns, where not set
    # Coordinates in the type of the file, where `rows` returns others: per part, a function of rows, and their number.
    stored: tuple[tuple[StoredCoordinates, int], ...] = ()


class TableFormat(PointFormat):
    """A format whose files are tables; a subclass opens and writes them."""

    @abstractmethod
    def open_table(self, path: Path, options: ReadOptions) -> PointTable:
        """Open a file."""

    def info(self, path: Path, options: ReadOptions) -> FileInfo:
        """Return the description of a file."""
        path = check_file(path)
        table = self.open_table(path, options)
        notes = [*table.notes, auto_note(options, table.crs, path)]
        first = self._cloud(table, path, options, 0, min(1, table.n_points), notes)
        columns = {name: values.dtype for name, values in first.columns.items()}
        notes.append(_precision_note(table, path, options))
        warnings = tuple(text for text in notes if text)
        return FileInfo(
            *(path, self.name, table.n_points, columns, first.origin, first.crs, None, table.details), notes=warnings
        )

    def read(self, path: Path, options: ReadOptions, *, start: int = 0, stop: int | None = None) -> PointCloud:
        """Read a range of rows."""
        path = check_file(path)
        table = self.open_table(path, options)
        return self._cloud(table, path, options, *clip_range(start, stop, table.n_points))

    def _cloud(
        self,
        table: PointTable,
        path: Path,
        options: ReadOptions,
        start: int,
        stop: int,
        notes: list[str] | None = None,
    ) -> PointCloud:
        options = with_units(options, table.crs, path)
        if table.guess and not options.columns:
            options = replace(options, columns=table.guess)
        names = resolve_columns(table.names, options, path)
        wanted = tuple(names.values())
        raw = table.rows(wanted, start, stop)
        first = raw if start == 0 and stop else table.rows(wanted, 0, min(1, table.n_points))
        return flat_cloud(
            {given: raw[name] for given, name in names.items()},
            first={given: first[name][:1] for given, name in names.items()},
            options=options,
            source=path,
            start=start,
            extremes=lambda given: _extremes(table, path, tuple(names[name] for name in given), options),
            crs=table.crs,
            notes=notes,
        )


def _extremes(table: PointTable, path: Path, names: tuple[str, ...], options: ReadOptions) -> tuple[float, float]:
    layout = (options.delimiter, options.decimal, options.header, options.comment, options.intensity_scale)
    key = (file_key(path), names, layout)
    if key not in _EXTREMES:
        low, high = np.inf, -np.inf
        for start in range(0, table.n_points, CHUNK):
            part = table.rows(names, start, min(start + CHUNK, table.n_points))
            for name in names:
                values = part[name]
                with np.errstate(invalid="ignore", over="ignore"):
                    if not np.isfinite(values.sum()):  # one pass without a mask, as in `check_finite`
                        values = values[np.isfinite(values)]
                if len(values):
                    low, high = min(low, float(values.min())), max(high, float(values.max()))
        _EXTREMES[key] = (low, high) if low <= high else (0.0, 0.0)
    return _EXTREMES[key]


def _precision_note(table: PointTable, path: Path, options: ReadOptions) -> str:
    options = replace(with_units(options, table.crs, path), columns=options.columns or table.guess, only=())
    names = resolve_columns(table.names, options, path)
    own = ((lambda start, stop: _stored(table, names, start, stop), table.n_points),)
    notes = (step_note(rows, n_points, options.factors) for rows, n_points in table.stored or own)
    return next((note for note in notes if note), "")


def _stored(table: PointTable, names: Mapping[str, str], start: int, stop: int) -> list[NDArray]:
    part = table.rows([names[axis] for axis in COORDINATES], start, stop)
    return [part[names[axis]] for axis in COORDINATES]


def check_record_size(path: Path, begin: int, n_points: int, size: int, column: str) -> None:
    """Raise `ReadError` for a header without one of its columns, whose points would be read from wrong places.

    That is so if the bytes behind the stated points are the same small number for each point, and are not such points.
    """
    file = open_content(path)
    more = file.size - begin - n_points * size
    if n_points < LEAST_RECORDS or more <= 0 or more % n_points or more // n_points >= size:
        return
    data = np.frombuffer(file.read(min(max(COMPARED, 8 * size), file.size - begin), begin), np.uint8)
    if more % size or _repeated(data, size + more // n_points) > _repeated(data, size):
        raise ReadError(
            f"{path}: its header describes points of {size} bytes, it holds {size + more // n_points} for each of "
            f"{n_points} points: the header lacks a {column}, or states a wrong type; correct it"
        )


def _repeated(data: NDArray[np.uint8], size: int) -> float:
    """Return the share of bytes that equal those of the next record, largest for the true size of records."""
    return float(np.mean(data[:-size] == data[size:]))


def with_points_only(table: PointTable, path: Path) -> PointTable:
    """Leave out rows whose three coordinates are NaN (beams that did not return); their number is logged."""
    if not set(COORDINATES) <= set(table.names):
        return table
    returned = []
    for start in range(0, table.n_points, CHUNK):
        stop = min(start + CHUNK, table.n_points)
        first = table.rows(COORDINATES[:1], start, stop)[COORDINATES[0]]
        with np.errstate(invalid="ignore", over="ignore"):
            if np.isfinite(first.sum()):  # no NaN: the other coordinates need not be read
                returned.append(np.ones(stop - start, np.bool_))
                continue
        part = table.rows(COORDINATES, start, stop)
        returned.append(~np.logical_and.reduce([np.isnan(part[name]) for name in COORDINATES]))
    if all(mask.all() for mask in returned):
        return table
    kept = np.flatnonzero(np.concatenate(returned)) if returned else np.empty(0, np.int64)
    n_lost = table.n_points - len(kept)
    logger.info("%s: %d of %d points are NaN, beams without return; they are left out", path, n_lost, table.n_points)

    def rows(names: Sequence[str], start: int, stop: int) -> Mapping[str, NDArray]:
        index = kept[start:stop]
        if not len(index):
            return table.rows(names, 0, 0)
        begin, end = int(index[0]), int(index[-1]) + 1
        part = table.rows(names, begin, end)
        return {name: values[index - begin] for name, values in part.items()}

    return replace(table, n_points=len(kept), rows=rows, details={**table.details, "without_return": n_lost})
