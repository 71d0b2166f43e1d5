"""PLY: ascii and binary, of either byte order, with any properties."""

import string
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from urllib.parse import quote

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.plain_text import shortened
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats import tables
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.files import Content, FileKey, file_key, open_content, output_file, with_packed
from mlsroad_pipeline.formats.ply.header import NAMES, PlyElement, PlyHeader, ply_head, read_ply_header
from mlsroad_pipeline.formats.text.values import WHITESPACE, RowForm, TextRows, index_rows, parse_rows, typed_column

SIZE_TYPES = ("i1", "u1", "i2", "u2", "i4", "u4")  # types of the number of items of a list


@lru_cache(maxsize=1)
def scattered_vertices(key: FileKey) -> Mapping[str, NDArray]:
    """Return the scalar properties of all vertices of a file, by name."""
    path = Path(key[0])
    header, file = read_ply_header(path), open_content(path)
    before = header.elements[: header.elements.index(header.vertex)]
    return _of_text(file, header, before) if header.encoding == "ascii" else _of_records(file, header, before)


def _truncated(path: Path, element: PlyElement, have: int) -> ReadError:
    what = "points" if element.name == "vertex" else f"records of {element.name!r}"
    return ReadError(f"{path} is truncated or damaged: its header states {element.count} {what}, it holds {have}")


def _of_records(file: Content, header: PlyHeader, before: tuple[PlyElement, ...]) -> Mapping[str, NDArray]:
    data = np.asarray(file.records(np.dtype("u1"), 0, file.size))
    at = header.begin
    nothing = np.empty((0, 0), np.uint8)
    for element in (*before, header.vertex):
        plan = _plan(element, file.path)
        if element.count * max(int(np.abs(plan[:, 0]).sum()), 1) > file.size - at and element.count:
            raise _truncated(file.path, element, (file.size - at) // max(int(np.abs(plan[:, 0]).sum()), 1))
        is_vertex = element is header.vertex
        dtype = element.dtype(header.order)
        out = np.empty((element.count, dtype.itemsize), np.uint8) if is_vertex else nothing
        at, have = _walk(data, at, element.count, plan, header.order == ">", out)
        if have < element.count:
            raise _truncated(file.path, element, int(have))
    table = out.reshape(-1).view(dtype) if dtype.itemsize else np.empty(0, dtype)
    return {name: table[name] for name in dtype.names or ()}


def _plan(element: PlyElement, path: Path) -> NDArray[np.int64]:
    """Return per property: bytes of a scalar, or minus the bytes of a list's size; its sign; bytes of an item."""
    plan = []
    for name, kind in element.properties.items():
        if kind is not None:
            plan.append((int(kind[1:]), 0, 0))
            continue
        size, item = element.lists[name]
        if size not in SIZE_TYPES:
            raise ReadError(f"{path}: property {name!r} is a list with a number of items of type {size}; use uchar")
        plan.append((-int(size[1:]), int(size[0] == "i"), int(item[1:])))
    return np.array(plan, np.int64).reshape(-1, 3)


@njit(cache=True, nogil=True)
def _walk(
    data: NDArray[np.uint8], at: int, count: int, plan: NDArray[np.int64], big_endian: bool, out: NDArray[np.uint8]
) -> tuple[int, int]:
    """Walk over records, copy their scalars to `out` where it has rows; return the end and the number of records."""
    end = len(data)
    for row in range(count):
        column = 0
        for p in range(len(plan)):
            width = abs(plan[p, 0])
            if at + width > end:
                return at, row
            if plan[p, 0] > 0:
                if len(out):
                    for i in range(width):
                        out[row, column + i] = data[at + i]
                    column += width
                at += width
                continue
            n_items = 0
            for i in range(width):
                n_items = n_items << 8 | data[at + (i if big_endian else width - 1 - i)]
            if plan[p, 1] and n_items >= 1 << (8 * width - 1):
                return at, row
            at += width + n_items * plan[p, 2]
            if at > end:
                return at, row
    return at, count


def _of_text(file: Content, header: PlyHeader, before: tuple[PlyElement, ...]) -> Mapping[str, NDArray]:
    at, vertex = header.begin, header.vertex
    for element in (element for element in before if element.count):
        rows = index_rows(file.path, file, at, 1, limit=element.count)
        if rows.n_rows < element.count:
            raise _truncated(file.path, element, rows.n_rows)
        at = rows.end
    names = [name for name, kind in vertex.properties.items() if kind is not None]
    if not vertex.count:
        return {name: np.empty(0, str(vertex.properties[name])) for name in names}
    rows = index_rows(file.path, file, at, 1, limit=vertex.count)
    if rows.n_rows < vertex.count:
        raise _truncated(file.path, vertex, rows.n_rows)
    lines = file.read(rows.end - at, at).splitlines()
    table = np.array([_scalars(line.split(), vertex, file.path) for line in lines[: vertex.count]], np.float64)
    return {
        name: typed_column(table[:, i], np.dtype(vertex.properties[name]), f"property {name!r}", file.path)
        for i, name in enumerate(names)
    }


def _scalars(words: list[bytes], vertex: PlyElement, path: Path) -> list[float]:
    """Return the scalars of a row of text; a list is its number of items and the items."""
    at, values = 0, []
    try:
        for kind in vertex.properties.values():
            if kind is not None:
                values.append(float(words[at]))
            elif int(words[at]) < 0:
                raise ValueError
            at += 1 if kind is not None else 1 + int(words[at])
        if at != len(words):
            raise ValueError
    except (ValueError, IndexError):
        row = shortened(b" ".join(words).decode("utf-8", "replace"))
        raise ReadError(f"{path} is damaged: {row!r} is not a row of its properties") from None
    return values


# Characters that a comment holds unchanged; the others are percent-encoded.
PLAIN = "".join(sorted(set(string.printable) - set("%" + string.whitespace))) + " "


class PlyFormat(tables.TableFormat):
    """Reader and writer of PLY.

    Properties keep their types, but `rgb`, `intensity` and labels become those of `PointCloud`. List properties of the
    vertices are left out; other elements, such as faces, are not points. Ranges are read at their byte offset where
    the vertices come first, as is usual; otherwise the vertices are held in memory.
    """

    name = "PLY"
    extensions: tuple[str, ...] = with_packed(".ply")
    signatures: tuple[bytes, ...] = (b"ply\n", b"ply\r")

    def open_table(self, path: Path, options: ReadOptions) -> tables.PointTable:
        """Open a file."""
        header = read_ply_header(path)
        scalars = tuple(name for name, kind in header.vertex.properties.items() if kind is not None)

        def rows(names: Sequence[str], start: int, stop: int) -> Mapping[str, NDArray]:
            raw = read_vertices(path, header, start, stop, threads=options.n_threads > 1)
            return {name: np.ascontiguousarray(raw[name], raw[name].dtype.newbyteorder("=")) for name in names}

        notes = _left_over(path, header)
        details = {"encoding": header.encoding, "elements": {e.name: e.count for e in header.elements}}
        return tables.PointTable(scalars, header.vertex.count, rows, header.crs, details, notes)

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write a cloud as binary little-endian PLY with coordinates in double precision.

        A CRS goes into a ``comment crs`` line. 64-bit integers are stored as doubles.
        """
        kinds = {name: values.dtype.str[1:] for name, values in tables.scalar_columns(cloud, options.metres).items()}
        types = {name: {"b1": "u1"}.get(kind, kind if kind in NAMES else "f8") for name, kind in kinds.items()}
        comments = ["crs " + quote(cloud.crs, safe=PLAIN)] if cloud.crs else []
        properties = [(name.replace(" ", "_"), kind) for name, kind in types.items()]
        with output_file(Path(path)) as stream:
            stream.write(ply_head(len(cloud), properties, comments))
            for part in tables.parts_of(cloud):
                records = np.empty(len(part), dtype=[(name, "<" + kind) for name, kind in types.items()])
                for name, values in tables.scalar_columns(part, options.metres).items():
                    records[name] = values
                stream.write(records.tobytes())


def _left_over(path: Path, header: PlyHeader) -> tuple[str, ...]:
    """Return a sentence on points behind those that the header states, where the vertices are the only element."""
    if not header.vertex_first or len(header.elements) > 1:
        return ()
    file, stated = open_content(path), header.vertex.count
    if header.encoding == "ascii":
        end = vertex_rows(path, header).end if stated else header.begin
        return tables.left_over(stated, index_rows(path, file, end, 1).n_rows, "rows")
    size = header.vertex.dtype(header.order).itemsize
    tables.check_record_size(path, header.begin, stated, size, "property")
    return tables.left_over(stated, file.size - header.begin - stated * size, "bytes")


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
        raise tables.truncated(path, vertex.count, have)
    table = file.records(dtype, header.begin, vertex.count)[start:stop]
    return {name: table[name] for name in dtype.names or ()}


def vertex_rows(path: Path, header: PlyHeader) -> TextRows:
    """Return the rows of an ascii file's vertices; `ReadError` if there are fewer than stated."""
    line_end = header.text[3:4] if header.text[3:5] != b"\r\n" else b"\n"
    rows = _vertex_rows(file_key(path), header.begin, header.text.count(line_end) + 1, header.vertex.count)
    if rows.n_rows < header.vertex.count:
        raise tables.truncated(path, header.vertex.count, rows.n_rows)
    return rows


@lru_cache(maxsize=4)
def _vertex_rows(key: FileKey, begin: int, first_line: int, count: int) -> TextRows:
    path = Path(key[0])
    return index_rows(path, open_content(path), begin, first_line, limit=count)
