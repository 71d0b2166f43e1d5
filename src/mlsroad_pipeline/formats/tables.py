"""Formats whose files are tables of scalar columns: description, reading by ranges, origin."""

import logging
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import FileInfo, PointFormat, ReadOptions
from mlsroad_pipeline.formats.column_names import resolve_columns
from mlsroad_pipeline.formats.crs import auto_note, with_units
from mlsroad_pipeline.formats.files import FileKey, check_file, clip_range, file_key, open_content
from mlsroad_pipeline.formats.standard_columns import COLOURS, COORDINATES, check_finite, origin_near, standard_cloud

# Function of a range of rows that returns their coordinates as stored.
StoredCoordinates = Callable[[int, int], Sequence[NDArray]]
LARGEST_STEP = 0.01  # largest distance of neighbouring numbers, in metres, that causes no warning
SAMPLES, SAMPLE = 5, 200  # number and length of the runs of points whose coordinates are compared with their type


def step_note(rows: StoredCoordinates, n_points: int, factors: NDArray[np.float64]) -> str:
    """Return a sentence on coordinates that are too large for the type that they are stored in.

    ``rows`` returns x, y and z of a range of rows as stored, ``factors`` convert them to metres. Empty where
    neighbouring numbers are less than `LARGEST_STEP` apart at half of the sampled points.
    """
    if not any(_is_narrow(values) for values in rows(0, min(1, n_points))):
        return ""
    starts = sorted({round(part * max(n_points - SAMPLE, 0)) for part in np.linspace(0, 1, SAMPLES)})
    parts = [rows(start, min(start + SAMPLE, n_points)) for start in starts]
    steps = {}
    for columns, factor in zip(zip(*parts, strict=True), factors, strict=True):
        values = np.concatenate(columns)
        values = values[np.isfinite(values)]
        if _is_narrow(values) and len(values):
            with np.errstate(over="ignore"):
                step = float(np.median(np.abs(np.spacing(values)))) * float(factor)
            steps[step] = 8 * values.dtype.itemsize
    step = max(steps, default=0.0)
    if not LARGEST_STEP < step < np.inf:
        return ""
    return (
        f"coordinates are stored as floats of {steps[step]} bits in steps of {step:g} m, too coarse for objects: "
        "export them with 64 bits, or relative to an offset"
    )


def _is_narrow(values: NDArray) -> bool:
    return values.dtype.kind == "f" and values.dtype.itemsize < 8


logger = logging.getLogger(__name__)

CHUNK = 1_000_000
LEAST_RECORDS = 100  # smallest number of points whose bytes are compared with the length of a file
COMPARED = 1 << 16  # least number of bytes whose repetition shows the size of a record
# Minima and maxima of columns of a file under given options.
_EXTREMES: dict[tuple[FileKey, tuple[str, ...], tuple[object, ...]], tuple[float, float]] = {}


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
    times: str = ""  # column that holds times, though its name may mean others; read as gps_time unless it is mapped
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
        self, table: PointTable, path: Path, options: ReadOptions, start: int, stop: int, notes: list[str] | None = None
    ) -> PointCloud:
        options = with_units(options, table.crs, path)
        if table.guess and not options.columns:
            options = replace(options, columns=table.guess)
        if table.times and "gps_time" not in options.columns and table.times not in options.columns.values():
            options = replace(options, columns={**options.columns, "gps_time": table.times})
        names = resolve_columns(table.names, options, path)
        wanted = tuple(names.values())
        raw = table.rows(wanted, start, stop)
        first = raw if start == 0 and stop else table.rows(wanted, 0, min(1, table.n_points))
        with np.errstate(invalid="ignore", over="ignore"):  # NaN and overflows raise below
            coordinates = [names[axis] for axis in COORDINATES]
            corner = np.array([float(first[name][0]) if len(first[name]) else 0.0 for name in coordinates])
            corner = corner * options.factors
            origin = origin_near(corner)  # a round point near the first
            xyz = np.empty((len(raw[coordinates[0]]), 3))
            for axis, name in enumerate(coordinates):
                if options.factors[axis] == 1.0:
                    xyz[:, axis] = raw[name]
                else:
                    np.multiply(raw[name], options.factors[axis], out=xyz[:, axis], dtype=np.float64)
            check_finite(xyz, source=path, start=start)
            if origin.any():
                xyz -= origin
            return standard_cloud(
                {given: raw[name] for given, name in names.items() if given not in COORDINATES},
                xyz,
                options=options,
                source=path,
                origin=origin,
                crs=table.crs,
                anchor=corner,
                extremes=lambda given: _extremes(table, path, tuple(names[name] for name in given), options),
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

    def stored(start: int, stop: int) -> list[NDArray]:
        part = table.rows([names[axis] for axis in COORDINATES], start, stop)
        return [part[names[axis]] for axis in COORDINATES]

    own = ((stored, table.n_points),)
    notes = (step_note(rows, n_points, options.factors) for rows, n_points in table.stored or own)
    return next((note for note in notes if note), "")


def truncated(path: Path, stated: int, have: int) -> ReadError:
    """Return the error for a file with fewer points than its header states."""
    return ReadError(f"{path} is truncated: its header states {stated} points, it holds {have}")


def left_over(stated: int, more: int, what: str) -> tuple[str, ...]:
    """Return a sentence on rows or bytes behind the stated points, if there are any."""
    return (f"its header states {stated} points, {more} more {what} follow: they are not read",) * (more > 0)


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


def scalar_columns(cloud: PointCloud, metres: float) -> dict[str, NDArray]:
    """Return a cloud as scalar columns in a file's unit, world coordinates (float64) first.

    Colours are split into red, green and blue; other columns of several values are numbered.
    """
    world = cloud.world_xyz() / metres
    columns: dict[str, NDArray] = {name: world[:, axis] for axis, name in enumerate(COORDINATES)}
    for name, values in cloud.columns.items():
        if values.ndim == 1:
            columns[name] = values
            continue
        parts = COLOURS if name == "rgb" else [f"{name}_{i}" for i in range(values.shape[1])]
        columns.update({part: values[:, i] for i, part in enumerate(parts)})
    return columns


def parts_of(cloud: PointCloud) -> Iterator[PointCloud]:
    """Yield consecutive parts of a cloud of up to `CHUNK` points."""
    for begin in range(0, len(cloud), CHUNK):
        yield cloud.select(np.arange(begin, min(begin + CHUNK, len(cloud))))
