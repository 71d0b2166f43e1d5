"""PCD, the format of the Point Cloud Library: ascii, binary and compressed."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.content import open_content, output_file, with_packed
from mlsroad_pipeline.formats.crs import write_sidecar
from mlsroad_pipeline.formats.files import FileKey, file_key
from mlsroad_pipeline.formats.pcd.header import PcdField, PcdHeader, read_pcd_header
from mlsroad_pipeline.formats.pcd.lzf import unpack
from mlsroad_pipeline.formats.standard_columns import COLOURS, COORDINATES, NEAR
from mlsroad_pipeline.formats.tables import (
    PointTable,
    TableFormat,
    check_record_size,
    parts_of,
    scalar_columns,
    with_points_only,
)
from mlsroad_pipeline.formats.text.rows import TextRows, index_rows
from mlsroad_pipeline.formats.text.values import WHITESPACE, RowForm, parse_rows, typed_column

PACKED_COLOURS = ("rgb", "rgba")
"""Fields of four bytes that hold blue, green, red and, in the last, alpha."""

KINDS_WRITTEN = "iuf"


class PcdFormat(TableFormat):
    """Reader and writer of PCD.

    Fields keep their names and types; SIZE, COUNT and padding (``_``) are respected, several values are numbered
    (``fpfh_0``), a packed `rgb` or `rgba` is split into channels. Points whose three coordinates are NaN stand for
    beams that did not return: they are left out and their number is logged. The viewpoint is part of `info` and not
    applied.
    """

    name = "PCD"
    extensions: tuple[str, ...] = with_packed(".pcd")
    signatures: tuple[bytes, ...] = (b"# .PCD", b"#.PCD", b"VERSION .7", b"VERSION 0.7", b"VERSION .6", b"VERSION 0.6")

    def recognises(self, path: Path, head: bytes) -> bool:
        """Return whether a file begins with a line of the header; comments and other lines count by the name alone."""
        if head.startswith(self.signatures):
            return True
        return path.name.lower().endswith(self.extensions) and head.lstrip().startswith((b"VERSION", b"FIELDS", b"#"))

    def open_table(self, path: Path, options: ReadOptions) -> PointTable:
        """Open a file."""
        return _open(file_key(path), options.n_threads > 1)

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write a cloud as binary PCD 0.7.

        Coordinates are float32 as the library expects them, or float64 where they are too large for that (1 km and more
        from zero). The CRS goes into a ``.prj`` beside the file.
        """
        dtype = _record_type(cloud, options, path)
        names = dtype.names or ()
        head = [
            *("# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", "FIELDS " + " ".join(names)),
            "SIZE " + " ".join(str(dtype[name].itemsize) for name in names),
            "TYPE " + " ".join("F" if name == "rgb" else dtype[name].kind.upper() for name in names),
            "COUNT " + " ".join("1" for _ in names),
            *(f"WIDTH {len(cloud)}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {len(cloud)}", "DATA binary"),
        ]
        with output_file(Path(path)) as stream:
            stream.write(("\n".join(head) + "\n").encode())
            for part in parts_of(cloud):
                columns = scalar_columns(part, options.metres)
                if "rgb" in names:
                    red, green, blue = (columns.pop(name).astype("<u4") for name in COLOURS)
                    columns["rgb"] = red << 16 | green << 8 | blue
                records = np.empty(len(part), dtype=dtype)
                for name in names:
                    records[name] = columns[name]
                stream.write(records.tobytes())
        write_sidecar(Path(path), cloud.crs)


def _record_type(cloud: PointCloud, options: WriteOptions, path: Path) -> np.dtype:
    far = (np.abs(cloud.origin) >= NEAR).any() or (len(cloud) and np.abs(cloud.xyz).max() >= NEAR)
    xyz = "<f8" if far or options.metres != 1.0 else "<f4"
    fields = []
    for name, values in scalar_columns(cloud.select(np.arange(0)), options.metres).items():
        kind = "u1" if values.dtype == np.bool_ else values.dtype.str[1:]
        if any(c.isspace() for c in name) or kind[0] not in KINDS_WRITTEN:
            raise DataError(f"{path}: column {name!r} ({values.dtype}) cannot be stored in PCD")
        if name in COLOURS:
            fields += [("rgb", "<u4")] if name == COLOURS[0] else []
        else:
            fields.append((name, xyz if name in COORDINATES else "<" + kind))
    return np.dtype(fields)


Values = Callable[[PcdField, int, int], NDArray]
"""Function that returns the values of a field for a range of rows, of shape (n, count)."""


@lru_cache(maxsize=2)
def _open(key: FileKey, threads: bool) -> PointTable:
    path = Path(key[0])
    header = read_pcd_header(path)
    reader = {"ascii": _text_values, "binary": _binary_values, "binary_compressed": _packed_values}[header.encoding]
    values = reader(path, header, threads)
    sources: dict[str, Callable[[int, int], NDArray]] = {}  # mypy cannot type lambdas that bind by their defaults
    for field in header.fields:
        if field.name in PACKED_COLOURS and field.dtype.itemsize == 4 and field.count == 1:
            for shift, name in zip((16, 8, 0, 24), (*COLOURS, "alpha")[: len(field.name)], strict=False):
                sources[name] = lambda a, b, f=field, s=shift: _colour(values(f, a, b), s)  # type: ignore[misc]
        else:
            named = field.count == len(COLOURS) and field.name in PACKED_COLOURS and field.dtype.itemsize == 1
            for i, name in enumerate(COLOURS if named else field.columns):
                sources[name] = lambda a, b, f=field, i=i: values(f, a, b)[:, i]  # type: ignore[misc]

    def rows(names: Sequence[str], start: int, stop: int) -> Mapping[str, NDArray]:
        parts = {name: sources[name](start, stop) for name in names}
        return {  # coordinates are copied into one array by the caller
            name: part if name in COORDINATES else np.ascontiguousarray(part) for name, part in parts.items()
        }

    details = {"encoding": header.encoding, **{k.lower(): v for k, v in header.entries.items() if k != "DATA"}}
    notes = (*_viewpoint_note(header), *_left_over(path, header))
    table = PointTable(tuple(sources), header.n_points, rows, None, details, notes)
    return with_points_only(table, path)


def _left_over(path: Path, header: PcdHeader) -> tuple[str, ...]:
    """Return a sentence on points behind those that the header states."""
    file, stated = open_content(path), header.n_points
    if header.encoding == "ascii":
        end = index_rows(path, file, header.begin, 1, limit=stated).end if stated else header.begin
        more, what = index_rows(path, file, end, 1).n_rows, "rows"
    else:
        size = stated * header.record_size
        if header.encoding == "binary_compressed":
            size = 8 + struct.unpack("<I", file.read(4, header.begin))[0]
        more, what = file.size - header.begin - size, "bytes"
        if header.encoding == "binary":
            check_record_size(path, header.begin, stated, header.record_size, "field")
    return (f"its header states {stated} points, {more} more {what} follow: they are not read",) * (more > 0)


def _viewpoint_note(header: PcdHeader) -> tuple[str, ...]:
    given = header.entries.get("VIEWPOINT", "").split()
    usual = ("0", "0", "0", "1", "0", "0", "0")
    if not given or [_number(word) for word in given] == [float(word) for word in usual]:
        return ()
    return (f"its VIEWPOINT {' '.join(given)} is not applied: coordinates are those of the file",)


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return np.nan


def _colour(values: NDArray, shift: int) -> NDArray[np.uint8]:
    bits = np.ascontiguousarray(values[:, 0]).view("<u4")
    return (bits >> shift & 255).astype(np.uint8)


def _binary_values(path: Path, header: PcdHeader, threads: bool) -> Values:
    del threads
    file = open_content(path)
    have = file.size - header.begin
    if have < header.n_points * header.record_size:
        raise ReadError(
            f"{path} is truncated: its header states {header.n_points} points of {header.record_size} bytes from byte "
            f"{header.begin}, it holds {have // max(header.record_size, 1)}"
        )
    if not header.n_points * header.record_size:
        return lambda field, start, stop: np.empty((max(stop - start, 0), field.count), field.dtype)
    table = file.records(np.dtype("u1"), header.begin, header.n_points * header.record_size)

    def values(field: PcdField, start: int, stop: int) -> NDArray:
        shape, strides = (max(stop - start, 0), field.count), (header.record_size, field.dtype.itemsize)
        offset = start * header.record_size + field.offset if shape[0] else 0
        return np.ndarray(shape, field.dtype, table, offset, strides)

    return values


def _packed_values(path: Path, header: PcdHeader, threads: bool) -> Values:
    del threads
    file = open_content(path)
    sizes = file.read(8, header.begin)
    if len(sizes) < 8:
        raise ReadError(f"{path} is truncated: its compressed data begin at byte {header.begin} and have no sizes")
    packed_size, size = struct.unpack("<II", sizes)
    if size != header.n_points * header.record_size:
        raise ReadError(
            f"{path} is damaged: {size} bytes of data for {header.n_points} points of {header.record_size} bytes"
        )
    packed = file.read(min(packed_size, file.size), header.begin + 8)
    if len(packed) < packed_size:
        raise ReadError(f"{path} is truncated: {len(packed)} of {packed_size} compressed bytes from {header.begin + 8}")
    try:
        data = unpack(packed, size)
    except ValueError as error:
        raise ReadError(f"{path} is damaged: its compressed data from byte {header.begin + 8}: {error}") from None

    def values(field: PcdField, start: int, stop: int) -> NDArray:  # field after field, each for all points
        begin = field.offset * header.n_points
        part = data[begin + start * field.size : begin + stop * field.size]
        return part.view(field.dtype).reshape(-1, field.count)

    return values


def _text_values(path: Path, header: PcdHeader, threads: bool) -> Values:
    width = sum(field.count for field in header.fields)
    first = {f: sum(g.count for g in header.fields[:i]) for i, f in enumerate(header.fields)}
    rows = index_rows(path, open_content(path), header.begin, header.n_lines + 1, limit=header.n_points)
    if rows.n_rows < header.n_points:
        raise ReadError(f"{path} is truncated: its header states {header.n_points} points, it holds {rows.n_rows}")
    parsed = _Parsed(rows, width, threads)

    def values(field: PcdField, start: int, stop: int) -> NDArray:
        at, what = first[field], f"field {field.name!r}"
        columns = [typed_column(c, field.dtype, what, path) for c in parsed.columns(start, stop)[at : at + field.count]]
        return np.stack(columns, axis=1) if columns else np.empty((stop - start, 0), field.dtype)

    return values


class _Parsed:
    """Parsed rows; the last range is cached, because columns are read one at a time."""

    def __init__(self, rows: TextRows, width: int, threads: bool) -> None:
        self._rows, self._width, self._threads = rows, width, threads
        self._last: tuple[tuple[int, int], list[NDArray[np.float64]]] = ((-1, -1), [])

    def columns(self, start: int, stop: int) -> list[NDArray[np.float64]]:
        """Return all columns of a range."""
        last = self._last
        if last[0] != (start, stop):
            rows = self._rows
            line = rows.first_line + start
            data = rows.read(start, stop)
            parsed = parse_rows(
                data, RowForm(self._width, WHITESPACE), path=rows.path, first_line=line, threads=self._threads
            )
            last = self._last = ((start, stop), parsed)
        return last[1]
