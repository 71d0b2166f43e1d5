"""PCD, the format of the Point Cloud Library: ascii, binary and compressed."""

import struct
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path

import lzf
import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats import tables
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.crs import write_sidecar
from mlsroad_pipeline.formats.files import FileKey, file_key, open_content, output_file, with_packed
from mlsroad_pipeline.formats.pcd.header import PcdHeader, read_pcd_header
from mlsroad_pipeline.formats.standard_columns import COLOURS, COORDINATES, NEAR
from mlsroad_pipeline.formats.text.values import WHITESPACE, RowForm, index_rows, parse_rows, typed_column

PACKED_COLOURS = ("rgb", "rgba")  # fields of four bytes that hold blue, green, red and, in the last, alpha
KINDS_WRITTEN = "iuf"

LARGEST_RATIO = 132  # maximum compression ratio of LZF: three bytes expand to at most 264. Data above it are damaged
# Function of names and a range of rows that returns these fields by name, each of shape (n,) or (n, count).
Rows = Callable[[set[str], int, int], Mapping[str, NDArray] | NDArray]


class PcdFormat(tables.TableFormat):
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

    def open_table(self, path: Path, options: ReadOptions) -> tables.PointTable:
        """Open a file."""
        return _open(file_key(path), options.n_threads > 1)

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write a cloud as binary PCD 0.7; `DataError` for names with blanks and types that PCD does not support.

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
            for part in tables.parts_of(cloud):
                columns = tables.scalar_columns(part, options.metres)
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
    for name, values in tables.scalar_columns(cloud.select(np.arange(0)), options.metres).items():
        kind = "u1" if values.dtype == np.bool_ else values.dtype.str[1:]
        if any(c.isspace() for c in name) or kind[0] not in KINDS_WRITTEN:
            raise DataError(f"{path}: column {name!r} ({values.dtype}) cannot be stored in PCD")
        if name in COLOURS:
            fields += [("rgb", "<u4")] if name == COLOURS[0] else []
        else:
            fields.append((name, xyz if name in COORDINATES else "<" + kind))
    return np.dtype(fields)


@lru_cache(maxsize=2)
def _open(key: FileKey, threads: bool) -> tables.PointTable:
    path = Path(key[0])
    header = read_pcd_header(path)
    sources: dict[str, tuple[str, Callable[[NDArray], NDArray]]] = {}  # column to its field and its part of it
    for field in header.fields:
        packed, size = field.name in PACKED_COLOURS, field.dtype.itemsize
        if packed and (size, field.count) == (4, 1):
            for shift, name in zip((16, 8, 0, 24), (*COLOURS, "alpha")[: len(field.name)], strict=False):
                sources[name] = field.name, partial(_colour, shift=shift)
        else:
            named = packed and (size, field.count) == (1, len(COLOURS))
            for i, name in enumerate(COLOURS if named else field.columns):
                sources[name] = field.name, partial(_part, index=i)
    if header.encoding == "ascii":
        read = _text_rows(path, header, threads)
    elif header.encoding == "binary":
        read = _binary_rows(path, header)
    else:
        read = _compressed_rows(path, header)

    def rows(names: Sequence[str], start: int, stop: int) -> Mapping[str, NDArray]:
        raw = read({sources[name][0] for name in names}, start, max(start, stop))
        parts = {name: sources[name][1](raw[sources[name][0]]) for name in names}
        return {  # coordinates are copied into one array by the caller
            name: part if name in COORDINATES else np.ascontiguousarray(part) for name, part in parts.items()
        }

    details = {"encoding": header.encoding, **{k.lower(): v for k, v in header.entries.items() if k != "DATA"}}
    notes = (*_viewpoint_note(header), *_left_over(path, header))
    table = tables.PointTable(tuple(sources), header.n_points, rows, None, details, notes)
    return tables.with_points_only(table, path)


def _left_over(path: Path, header: PcdHeader) -> tuple[str, ...]:
    """Return a sentence on points behind those that the header states."""
    file, stated = open_content(path), header.n_points
    if header.encoding == "ascii":
        end = index_rows(path, file, header.begin, 1, limit=stated).end if stated else header.begin
        return tables.left_over(stated, index_rows(path, file, end, 1).n_rows, "rows")
    size = stated * header.dtype.itemsize
    if header.encoding == "binary":
        tables.check_record_size(path, header.begin, stated, header.dtype.itemsize, "field")
    else:
        size = 8 + struct.unpack("<I", file.read(4, header.begin))[0]
    return tables.left_over(stated, file.size - header.begin - size, "bytes")


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


def _part(values: NDArray, index: int) -> NDArray:
    return values if values.ndim == 1 else np.asarray(values[:, index])


def _colour(values: NDArray, shift: int) -> NDArray[np.uint8]:
    return (np.ascontiguousarray(values).view("<u4") >> shift & 255).astype(np.uint8)


def _binary_rows(path: Path, header: PcdHeader) -> Rows:
    file, size = open_content(path), header.dtype.itemsize
    have = file.size - header.begin
    if have < header.n_points * size:
        raise ReadError(
            f"{path} is truncated: its header states {header.n_points} points of {size} bytes from byte "
            f"{header.begin}, it holds {have // max(size, 1)}"
        )
    table = file.records(header.dtype, header.begin, header.n_points if size else 0)
    return lambda names, start, stop: table[start:stop]


def _compressed_rows(path: Path, header: PcdHeader) -> Rows:
    file, wanted = open_content(path), header.n_points * header.dtype.itemsize
    sizes = file.read(8, header.begin)
    if len(sizes) < 8:
        raise ReadError(f"{path} is truncated: its compressed data begin at byte {header.begin} and have no sizes")
    packed_size, size = struct.unpack("<II", sizes)
    if size != wanted:
        raise ReadError(
            f"{path} is damaged: {size} bytes of data for {header.n_points} points of {header.dtype.itemsize} bytes"
        )
    packed = file.read(min(packed_size, file.size), header.begin + 8)
    if len(packed) < packed_size:
        raise ReadError(f"{path} is truncated: {len(packed)} of {packed_size} compressed bytes from {header.begin + 8}")
    try:
        if size > LARGEST_RATIO * packed_size:
            raise ValueError(f"{packed_size} bytes cannot decompress to {size}")
        unpacked = lzf.decompress(packed, size) if size else b""
        if unpacked is None:
            raise ValueError(f"they decompress to more than {size} bytes")
        data = np.frombuffer(unpacked, np.uint8)
        if len(data) != size:
            raise ValueError(f"they decompress to {len(data)} bytes instead of {size}")
    except ValueError as error:
        raise ReadError(f"{path} is damaged: its compressed data from byte {header.begin + 8}: {error}") from None
    fields, at = {}, 0
    for field in header.fields:  # field after field, each for all points
        end = at + field.size * header.n_points
        fields[field.name] = data[at:end].view(field.dtype).reshape(header.n_points, *field.shape)
        at = end
    return lambda names, start, stop: {name: fields[name][start:stop] for name in names}


def _text_rows(path: Path, header: PcdHeader, threads: bool) -> Rows:
    width = sum(field.count for field in header.fields)
    rows = index_rows(path, open_content(path), header.begin, header.n_lines + 1, limit=header.n_points)
    if rows.n_rows < header.n_points:
        raise tables.truncated(path, header.n_points, rows.n_rows)
    form = RowForm(width, WHITESPACE)

    first = dict(zip(header.fields, np.cumsum([0, *(field.count for field in header.fields)]).tolist(), strict=False))

    def read(names: set[str], start: int, stop: int) -> Mapping[str, NDArray]:
        line = rows.first_line + start
        parsed = parse_rows(rows.read(start, stop), form, path=path, first_line=line, threads=threads)
        fields = {}
        for field in (field for field in header.fields if field.name in names and field.columns):
            own = parsed[first[field] : first[field] + field.count]
            typed = [typed_column(values, field.dtype, f"field {field.name!r}", path) for values in own]
            fields[field.name] = np.stack(typed, axis=1).reshape(stop - start, *field.shape)
        return fields

    return read
