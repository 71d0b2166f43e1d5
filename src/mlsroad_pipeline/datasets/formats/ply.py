"""PLY: ascii and binary, of either byte order, with any properties."""

from __future__ import annotations

import string
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from urllib.parse import quote

import numpy as np
import plyfile
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.exceptions import ReadError
from mlsroad_pipeline.algorithms.point_cloud import PointCloud
from mlsroad_pipeline.datasets.formats.base import FileInfo, PointFormat, ReadOptions, WriteOptions
from mlsroad_pipeline.datasets.formats.files import FileKey, atomic_file, check_file, clip_range, file_key
from mlsroad_pipeline.datasets.formats.flat_table import flat_cloud, scalar_columns
from mlsroad_pipeline.datasets.formats.ply_header import TYPES, PlyHeader, read_ply_header
from mlsroad_pipeline.datasets.formats.standard_columns import resolve_columns
from mlsroad_pipeline.datasets.formats.text_rows import TextBytes, TextRows, index_rows
from mlsroad_pipeline.datasets.formats.text_values import WHITESPACE, RowForm, parse_rows

CHUNK = 1_000_000
PLAIN = "".join(sorted(set(string.printable) - set("%" + string.whitespace))) + " "
"""What a comment can hold as it stands; the rest is percent-encoded."""

PLY_NAMES = {
    **{"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint"},
    **{"f4": "float", "f8": "double"},
}


class PlyFormat(PointFormat):
    """Reader and writer of PLY.

    Properties keep their types, but `rgb`, `intensity` and labels become what `PointCloud` says. List properties of the
    vertices are left out; other elements, such as faces, are not points. Ranges are read from their place where the
    vertices come first, as they do in practice; otherwise the file is held in memory.
    """

    name = "PLY"
    extensions: tuple[str, ...] = (".ply",)
    signatures: tuple[bytes, ...] = (b"ply\n", b"ply\r")

    def info(self, path: Path, options: ReadOptions) -> FileInfo:
        """Return what a file's head says.

        Parameters
        ----------
        path : Path
            The file.
        options : ReadOptions
            How to read it.

        Returns
        -------
        FileInfo
            Its description; PLY says nothing of bounds.

        Raises
        ------
        ReadError
            If the file is not PLY or is damaged.
        MissingColumnError
            If a mapped column is not in the file.
        """
        path = check_file(path)
        header = read_ply_header(path)
        first = self.read(path, options, start=0, stop=1)
        columns = {name: values.dtype for name, values in first.columns.items()}
        details = {"encoding": header.encoding, "elements": {e.name: e.count for e in header.elements}}
        return FileInfo(path, self.name, header.vertex.count, columns, first.origin, first.crs, None, details)

    def read(self, path: Path, options: ReadOptions, *, start: int = 0, stop: int | None = None) -> PointCloud:
        """Read a range of vertices.

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
            If the file is not PLY, truncated or damaged.
        MissingColumnError
            If a mapped column is not in the file.
        DataError
            If a value is outside its domain.
        """
        path = check_file(path)
        header = read_ply_header(path)
        start, stop = clip_range(start, stop, header.vertex.count)
        scalars = [name for name, kind in header.vertex.properties.items() if kind is not None]
        names = resolve_columns(scalars, options, path)
        raw = read_vertices(path, header, start, stop)
        first = read_vertices(path, header, 0, min(1, header.vertex.count))
        return flat_cloud(
            {given: _native(raw[name]) for given, name in names.items()},
            first={given: first[name] for given, name in names.items()},
            options=options,
            source=path,
            start=start,
            maximum=lambda given: file_maximum(file_key(path), tuple(names[name] for name in given)),
            crs=header.crs,
        )

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write a cloud as binary little-endian PLY with coordinates in double precision.

        Parameters
        ----------
        path : Path
            The file to write.
        cloud : PointCloud
            The points; a CRS goes into a ``comment crs`` line. 64-bit integers are stored as doubles.
        options : WriteOptions
            Its units.
        """
        types = {name: _ply_type(values.dtype) for name, values in scalar_columns(cloud, options.metres).items()}
        head = ["ply", "format binary_little_endian 1.0"]
        if cloud.crs:
            head.append("comment crs " + quote(cloud.crs, safe=PLAIN))
        head.append(f"element vertex {len(cloud)}")
        head += [f"property {PLY_NAMES[kind]} {name.replace(' ', '_')}" for name, kind in types.items()]
        with atomic_file(path) as stream:
            stream.write(("\n".join([*head, "end_header"]) + "\n").encode())
            for begin in range(0, len(cloud), CHUNK):
                part = cloud.select(np.arange(begin, min(begin + CHUNK, len(cloud))))
                records = np.empty(len(part), dtype=[(name, "<" + kind) for name, kind in types.items()])
                for name, values in scalar_columns(part, options.metres).items():
                    records[name] = values
                stream.write(records.tobytes())


def _ply_type(dtype: np.dtype) -> str:
    kind = "u1" if dtype == np.bool_ else dtype.str[1:]
    return kind if kind in TYPES.values() else "f8"


def _native(values: NDArray) -> NDArray:
    return np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("="))


def read_vertices(path: Path, header: PlyHeader, start: int, stop: int) -> Mapping[str, NDArray]:
    """Return the scalar properties of a range of vertices.

    Parameters
    ----------
    path : Path
        The file.
    header : PlyHeader
        Its head.
    start, stop : int
        First row and the row after the last, inside the file.

    Returns
    -------
    mapping of str to ndarray of shape (n,)
        Properties by name; views of the file where it is binary.

    Raises
    ------
    ReadError
        If the file ends early or a row of text is not understood.
    """
    vertex = header.vertex
    if not header.vertex_first:
        data = _whole_file(file_key(path))
        return {name: np.asarray(data[name][start:stop]) for name, kind in vertex.properties.items() if kind}
    dtype = vertex.dtype(header.order)
    if header.encoding == "ascii":
        rows = vertex_rows(path, header)
        form = RowForm(len(dtype.names or ()), WHITESPACE)
        columns = parse_rows(rows.read(start, stop), form, path=path, first_line=rows.first_line + start)
        named = zip(vertex.properties.items(), columns, strict=True)
        return {name: _typed(values, np.dtype(kind), name, path) for (name, kind), values in named}
    size, needed = path.stat().st_size - header.begin, vertex.count * dtype.itemsize
    if size < needed:
        have = size // dtype.itemsize
        raise ReadError(f"{path} is truncated: its head says {vertex.count} points, it holds {have}")
    if not vertex.count:
        return {name: np.empty(0, dtype[name]) for name in dtype.names or ()}
    table = np.memmap(path, dtype=dtype, mode="r", offset=header.begin, shape=(vertex.count,))[start:stop]
    return {name: table[name] for name in dtype.names or ()}


def _typed(values: NDArray[np.float64], dtype: np.dtype, name: str, path: Path) -> NDArray:
    if dtype.kind == "f":
        return values.astype(dtype)
    limits = np.iinfo(dtype)
    if len(values) and not limits.min <= values.min() <= values.max() <= limits.max:
        low, high = values.min(), values.max()
        raise ReadError(f"{path}: property {name!r} has values {low} to {high}, outside its type {dtype}")
    return values.astype(dtype)


def vertex_rows(path: Path, header: PlyHeader) -> TextRows:
    """Return the rows of an ascii file's vertices.

    Parameters
    ----------
    path : Path
        The file.
    header : PlyHeader
        Its head.

    Returns
    -------
    TextRows
        The rows; remembered as long as the file does not change.

    Raises
    ------
    ReadError
        If there are fewer rows than the head says.
    """
    rows = _vertex_rows(file_key(path), header.begin, header.text.count(b"\n") + 1, header.vertex.count)
    if rows.n_rows < header.vertex.count:
        raise ReadError(f"{path} is truncated: its head says {header.vertex.count} points, it holds {rows.n_rows}")
    return rows


@lru_cache(maxsize=4)
def _vertex_rows(key: FileKey, begin: int, first_line: int, count: int) -> TextRows:
    path = Path(key[0])
    return index_rows(path, TextBytes(path), begin, first_line, limit=count)


@lru_cache(maxsize=1)
def _whole_file(key: FileKey) -> plyfile.PlyElement:
    try:
        return plyfile.PlyData.read(key[0])["vertex"]
    except (plyfile.PlyParseError, ValueError) as error:
        raise ReadError(f"{key[0]} is damaged: {error}") from error


@lru_cache(maxsize=64)
def file_maximum(key: FileKey, names: tuple[str, ...]) -> float:
    """Return the greatest value of properties over a whole file.

    Parameters
    ----------
    key : tuple
        See `file_key`.
    names : tuple of str
        Properties.

    Returns
    -------
    float
        Their maximum, NaN left out.
    """
    path = Path(key[0])
    header = read_ply_header(path)
    greatest = 0.0
    for start in range(0, header.vertex.count, CHUNK):
        part = read_vertices(path, header, start, min(start + CHUNK, header.vertex.count))
        greatest = max(greatest, *(float(np.nanmax(part[name])) for name in names))
    return greatest
