"""Text: one point a row, with or without a head of comments and a row of names, plain or gzip."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.point_cloud import PointCloud
from mlsroad_pipeline.datasets.formats.base import FileInfo, PointFormat, ReadOptions, WriteOptions
from mlsroad_pipeline.datasets.formats.crs import write_sidecar
from mlsroad_pipeline.datasets.formats.files import FileKey, atomic_file, check_file, clip_range, file_key
from mlsroad_pipeline.datasets.formats.flat_table import flat_cloud, write_columns
from mlsroad_pipeline.datasets.formats.standard_columns import resolve_columns
from mlsroad_pipeline.datasets.formats.text_layout import TextTable, open_table
from mlsroad_pipeline.datasets.formats.text_values import parse_rows

CHUNK = 1_000_000


class TextFormat(PointFormat):
    """Reader and writer of text tables.

    Without a row of names the columns are x, y, z, column_3, column_4 and so on, from 0; colours among them are found
    by their values (`text_layout`). Columns of words are left out. All values are float64, but `label` and `instance`
    int32, `rgb` uint8 and `intensity` float32.
    """

    name = "text"
    extensions: tuple[str, ...] = (
        *(".txt", ".xyz", ".csv", ".asc", ".pts", ".xyz_label_conf"),
        *(".txt.gz", ".xyz.gz", ".csv.gz", ".asc.gz", ".pts.gz", ".xyz_label_conf.gz"),
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
        details = {"delimiter": table.delimiter, "decimal": table.form.decimal, "names": table.names}
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
        if table.guess and not options.columns:
            options = replace(options, columns=table.guess)
        names = resolve_columns(table.numeric_names, options, path)
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
        write_sidecar(Path(path), cloud.crs)


def _columns(table: TextTable, start: int, stop: int, threads: bool) -> dict[str, NDArray[np.float64]]:
    data = table.rows.read(start, stop)
    line = table.rows.first_line + start
    parsed = parse_rows(data, table.form, path=table.rows.path, first_line=line, threads=threads)
    return dict(zip(table.numeric_names, parsed, strict=True))


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
