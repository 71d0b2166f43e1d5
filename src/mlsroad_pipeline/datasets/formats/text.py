"""Text: one point a row, with or without a head of comments and a row of names, plain or gzip."""

from __future__ import annotations

import gzip
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.exceptions import ReadError
from mlsroad_pipeline.algorithms.point_cloud import PointCloud
from mlsroad_pipeline.datasets.formats.base import FileInfo, PointFormat, ReadOptions, WriteOptions
from mlsroad_pipeline.datasets.formats.files import FileKey, atomic_file, check_file, clip_range, file_key
from mlsroad_pipeline.datasets.formats.flat_table import flat_cloud, write_columns
from mlsroad_pipeline.datasets.formats.standard_columns import resolve_columns
from mlsroad_pipeline.datasets.formats.text_rows import (
    WHITESPACE,
    TextBytes,
    TextRows,
    index_rows,
    is_number,
    parse_rows,
    split_row,
)

DELIMITERS = (";", ",", "\t")
LAYOUTS = {".xyz_label_conf": ("x", "y", "z", "label", "confidence")}
"""Columns of files without a row of names whose extension tells them (Oakland 3-D)."""

CHUNK = 1_000_000
HEAD = 1 << 20


@dataclass(frozen=True)
class TextTable:
    """A text file's rows and what was found out about them.

    Parameters
    ----------
    rows : TextRows
        Where the rows are.
    names : tuple of str
        Names of the columns: of the file, or else `LAYOUTS` or x, y, z, column_3, ...
    delimiter : str
        What stands between two values, or `WHITESPACE` for any run of blanks.
    head : bytes
        The lines before the first row: comments, and the names if there are any.
    has_names : bool
        Whether the file has a row of names.
    """

    rows: TextRows
    names: tuple[str, ...]
    delimiter: str
    head: bytes
    has_names: bool


class TextFormat(PointFormat):
    """Reader and writer of text tables.

    Without a row of names the columns are x, y, z, column_3, column_4 and so on, from 0. All values are float64, but
    `label` and `instance` int32, `rgb` uint8 and `intensity` float32.
    """

    name = "text"
    extensions: tuple[str, ...] = (
        *(".txt", ".xyz", ".csv", ".asc", ".xyz_label_conf"),
        *(".txt.gz", ".xyz.gz", ".csv.gz", ".asc.gz", ".xyz_label_conf.gz"),
    )
    signatures: tuple[bytes, ...] = ()

    def info(self, path: Path, options: ReadOptions) -> FileInfo:
        """Return what a text file holds; its rows are counted, not parsed.

        Parameters
        ----------
        path : Path
            The file.
        options : ReadOptions
            How to read it.

        Returns
        -------
        FileInfo
            Its description; text says nothing of bounds or CRS.

        Raises
        ------
        ReadError
            If the file holds no rows of numbers.
        MissingColumnError
            If a mapped column is not in the file.
        """
        path = check_file(path)
        table = open_table(path, options)
        first = self.read(path, options, start=0, stop=1)
        columns = {name: values.dtype for name, values in first.columns.items()}
        details = {"delimiter": table.delimiter, "names": table.names}
        return FileInfo(path, self.name, table.rows.n_rows, columns, first.origin, first.crs, None, details)

    def read(self, path: Path, options: ReadOptions, *, start: int = 0, stop: int | None = None) -> PointCloud:
        """Read a range of rows.

        Parameters
        ----------
        path : Path
            The file.
        options : ReadOptions
            How to read it.
        start, stop : int
            First row and the row after the last; None is the end. Beyond the end is clipped.

        Returns
        -------
        PointCloud
            The points, float64, relative to a round point near the file's first.

        Raises
        ------
        ReadError
            If a row is ragged or not numeric; the message gives file, line and content.
        MissingColumnError
            If a mapped column is not in the file.
        DataError
            If a value is outside its domain.
        """
        path = check_file(path)
        table = open_table(path, options)
        start, stop = clip_range(start, stop, table.rows.n_rows)
        names = resolve_columns(table.names, options, path)
        raw = _columns(table, start, stop, options.n_threads > 1)
        first = _columns(table, 0, 1, False)
        return flat_cloud(
            {given: raw[name] for given, name in names.items()},
            first={given: first[name] for given, name in names.items()},
            options=options,
            source=path,
            start=start,
            maximum=lambda given: file_maximum(table, tuple(names[name] for name in given)),
        )

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write a cloud as text with a row of names, packed where the path ends in ``.gz``.

        Floats other than coordinates are written with as many digits as it takes to read them back unchanged.

        Parameters
        ----------
        path : Path
            The file to write.
        cloud : PointCloud
            The points.
        options : WriteOptions
            Delimiter, decimals of the coordinates, units.
        """
        path = Path(path)
        with atomic_file(path) as stream:
            # No name and no time in the gzip head: same points, same bytes.
            packed = gzip.GzipFile("", "wb", 6, stream, mtime=0) if path.suffix.lower() == ".gz" else None
            out = packed if packed is not None else stream
            for begin in range(0, max(len(cloud), 1), CHUNK):
                part = cloud.select(np.arange(begin, min(begin + CHUNK, len(cloud))))
                out.write(write_columns(part, options, with_names=begin == 0))
            if packed is not None:
                packed.close()


def _columns(table: TextTable, start: int, stop: int, threads: bool) -> dict[str, NDArray[np.float64]]:
    data = table.rows.read(start, stop)
    line = table.rows.first_line + start
    parsed = parse_rows(data, len(table.names), table.delimiter, path=table.rows.path, first_line=line, threads=threads)
    return dict(zip(table.names, parsed, strict=True))


def open_table(path: Path, options: ReadOptions) -> TextTable:
    """Find a text file's delimiter, names and rows.

    Parameters
    ----------
    path : Path
        The file.
    options : ReadOptions
        Its `delimiter`, `header` and `comment`.

    Returns
    -------
    TextTable
        What was found; remembered as long as the file does not change.

    Raises
    ------
    ReadError
        If there is no row.
    """
    return _open_table(file_key(path), options.delimiter, options.header, options.comment)


@lru_cache(maxsize=4)
def _open_table(key: FileKey, delimiter: str | None, header: bool | None, comment: str) -> TextTable:
    path = Path(key[0])
    text = TextBytes(path)
    lines = text.read(HEAD).splitlines(keepends=True)
    n_head = next((i for i, line in enumerate(lines) if line.strip() and not _is_comment(line, comment)), len(lines))
    if n_head == len(lines):
        raise ReadError(f"{path} has no rows of points")
    sample = [
        line.decode("utf-8-sig", "replace").rstrip("\r\n") for line in lines[n_head : n_head + 20] if line.strip()
    ]
    found = delimiter or _sniffed(sample[-1] if len(sample) < 3 else sample[1])
    first = split_row(sample[0].lstrip("/"), found)
    has_names = header if header is not None else not all(is_number(value) for value in first)
    if header is None and has_names and sum(is_number(value) for value in first) > 0:
        raise ReadError(f"{path}, line {n_head + 1}: neither numbers nor names: {sample[0]!r}")
    if has_names and n_head + 1 == len(lines):
        raise ReadError(f"{path} has no rows of points")
    row_line = n_head + int(has_names)
    begin = sum(len(line) for line in lines[:row_line])
    if n_head == 0 and not has_names and lines[0].startswith(b"\xef\xbb\xbf"):
        begin = 3
    width = len(split_row(sample[int(has_names and len(sample) > 1)], found))
    names = _names(first, width, path, n_head + 1) if has_names else _default_names(path, width)
    rows = index_rows(path, text, begin, row_line + 1)
    return TextTable(rows, names, found, b"".join(lines[:row_line]), has_names)


def _is_comment(line: bytes, comment: str) -> bool:
    return line.lstrip(b"\xef\xbb\xbf \t").startswith(comment.encode())


def _sniffed(row: str) -> str:
    found = next((d for d in DELIMITERS if d in row.strip()), None)
    if found is not None:
        return found
    return WHITESPACE if "  " in row or row != row.strip() else " "


def _names(values: Sequence[str], width: int, path: Path, line: int) -> tuple[str, ...]:
    names = tuple(value.strip('"') for value in values)
    if len(names) != width:
        raise ReadError(f"{path}, line {line}: {len(names)} names for {width} values")
    if len(set(names)) < len(names):
        raise ReadError(f"{path}, line {line}: a name stands twice: {', '.join(names)}")
    return names


def _default_names(path: Path, width: int) -> tuple[str, ...]:
    name = path.name.lower().removesuffix(".gz")
    known = next((layout for e, layout in LAYOUTS.items() if name.endswith(e) and len(layout) == width), ())
    if known:
        return known
    if width < 3:
        raise ReadError(f"{path} has {width} values a row; x, y and z are the least")
    return ("x", "y", "z", *(f"column_{i}" for i in range(3, width)))


def file_maximum(table: TextTable, names: tuple[str, ...]) -> float:
    """Return the greatest value of columns over a whole file.

    Parameters
    ----------
    table : TextTable
        The file.
    names : tuple of str
        Its columns.

    Returns
    -------
    float
        Their maximum, NaN left out.
    """
    key = file_key(table.rows.path)
    if (key, names) not in _MAXIMA:
        greatest = 0.0
        for start in range(0, table.rows.n_rows, CHUNK):
            columns = _columns(table, start, min(start + CHUNK, table.rows.n_rows), False)
            greatest = max(greatest, *(float(np.nanmax(columns[name], initial=0.0)) for name in names))
        _MAXIMA[key, names] = greatest
    return _MAXIMA[key, names]


_MAXIMA: dict[tuple[FileKey, tuple[str, ...]], float] = {}
