"""PLY: ascii and binary, of either byte order, with any properties."""

import string
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.files import FileKey, file_key, open_content, output_file, with_packed
from mlsroad_pipeline.formats.ply.header import NAMES, PlyHeader, ply_head, read_ply_header
from mlsroad_pipeline.formats.ply.vertices import scattered_vertices
from mlsroad_pipeline.formats.tables import (
    PointTable,
    TableFormat,
    check_record_size,
    left_over,
    parts_of,
    scalar_columns,
    truncated,
)
from mlsroad_pipeline.formats.text.values import WHITESPACE, RowForm, TextRows, index_rows, parse_rows, typed_column

# Characters that a comment holds unchanged; the others are percent-encoded.
PLAIN = "".join(sorted(set(string.printable) - set("%" + string.whitespace))) + " "


class PlyFormat(TableFormat):
    """Reader and writer of PLY.

    Properties keep their types, but `rgb`, `intensity` and labels become those of `PointCloud`. List properties of the
    vertices are left out; other elements, such as faces, are not points. Ranges are read at their byte offset where
    the vertices come first, as is usual; otherwise the vertices are held in memory.
    """

    name = "PLY"
    extensions: tuple[str, ...] = with_packed(".ply")
    signatures: tuple[bytes, ...] = (b"ply\n", b"ply\r")

    def open_table(self, path: Path, options: ReadOptions) -> PointTable:
        """Open a file."""
        header = read_ply_header(path)
        scalars = tuple(name for name, kind in header.vertex.properties.items() if kind is not None)

        def rows(names: Sequence[str], start: int, stop: int) -> Mapping[str, NDArray]:
            raw = read_vertices(path, header, start, stop, threads=options.n_threads > 1)
            return {name: np.ascontiguousarray(raw[name], raw[name].dtype.newbyteorder("=")) for name in names}

        notes = _left_over(path, header)
        details = {"encoding": header.encoding, "elements": {e.name: e.count for e in header.elements}}
        return PointTable(scalars, header.vertex.count, rows, header.crs, details, notes)

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write a cloud as binary little-endian PLY with coordinates in double precision.

        A CRS goes into a ``comment crs`` line. 64-bit integers are stored as doubles.
        """
        kinds = {name: values.dtype.str[1:] for name, values in scalar_columns(cloud, options.metres).items()}
        types = {name: {"b1": "u1"}.get(kind, kind if kind in NAMES else "f8") for name, kind in kinds.items()}
        comments = ["crs " + quote(cloud.crs, safe=PLAIN)] if cloud.crs else []
        properties = [(name.replace(" ", "_"), kind) for name, kind in types.items()]
        with output_file(Path(path)) as stream:
            stream.write(ply_head(len(cloud), properties, comments))
            for part in parts_of(cloud):
                records = np.empty(len(part), dtype=[(name, "<" + kind) for name, kind in types.items()])
                for name, values in scalar_columns(part, options.metres).items():
                    records[name] = values
                stream.write(records.tobytes())


def _left_over(path: Path, header: PlyHeader) -> tuple[str, ...]:
    """Return a sentence on points behind those that the header states, where the vertices are the only element."""
    if not header.vertex_first or len(header.elements) > 1:
        return ()
    file, stated = open_content(path), header.vertex.count
    if header.encoding == "ascii":
        end = vertex_rows(path, header).end if stated else header.begin
        return left_over(stated, index_rows(path, file, end, 1).n_rows, "rows")
    size = header.vertex.dtype(header.order).itemsize
    check_record_size(path, header.begin, stated, size, "property")
    return left_over(stated, file.size - header.begin - stated * size, "bytes")


def read_vertices(
    path: Path, header: PlyHeader, start: int, stop: int, *, threads: bool = False
) -> Mapping[str, NDArray]:
    """Return the scalar properties of a range of vertices by name; views of the file where it is binary."""
    vertex = header.vertex
    if not header.vertex_first:
        return {name: values[start:stop] for name, values in scattered_vertices(file_key(path)).items()}
    dtype = vertex.dtype(header.order)
    if header.encoding == "ascii":
        rows = vertex_rows(path, header)
        form = RowForm(len(dtype.names or ()), WHITESPACE)
        line = rows.first_line + start
        columns = parse_rows(rows.read(start, stop), form, path=path, first_line=line, threads=threads)
        named = zip(vertex.properties.items(), columns, strict=True)
        return {
            name: typed_column(values, np.dtype(kind), f"property {name!r}", path) for (name, kind), values in named
        }
    file = open_content(path)
    have = (file.size - header.begin) // max(dtype.itemsize, 1)
    if dtype.itemsize and have < vertex.count:
        raise truncated(path, vertex.count, have)
    table = file.records(dtype, header.begin, vertex.count)[start:stop]
    return {name: table[name] for name in dtype.names or ()}


def vertex_rows(path: Path, header: PlyHeader) -> TextRows:
    """Return the rows of an ascii file's vertices; `ReadError` if there are fewer than stated."""
    line_end = header.text[3:4] if header.text[3:5] != b"\r\n" else b"\n"
    rows = _vertex_rows(file_key(path), header.begin, header.text.count(line_end) + 1, header.vertex.count)
    if rows.n_rows < header.vertex.count:
        raise truncated(path, header.vertex.count, rows.n_rows)
    return rows


@lru_cache(maxsize=4)
def _vertex_rows(key: FileKey, begin: int, first_line: int, count: int) -> TextRows:
    path = Path(key[0])
    return index_rows(path, open_content(path), begin, first_line, limit=count)
