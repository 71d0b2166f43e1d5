"""Files of results: point clouds and tables as Parquet, arrays as NPZ; equal results give equal bytes.

A result is a `PointCloud`, a pandas `DataFrame`, a mapping of names to arrays, or a mapping of part names to any of
these, with one file per part. Reading restores number, order, names, dtypes and bits.
"""

import functools
import json
import math
import mmap
import os
import re
import struct
import sys
import zipfile
import zlib
from collections.abc import Mapping
from io import RawIOBase
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy import sparse

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud

_LOCAL_HEADER = struct.Struct("<26xHH")
"""End of the local header of a zip entry: lengths of the name and of the extra field that follow it."""

_BLOCK = 1 << 24


def map_arrays(path: str | Path) -> dict[str, NDArray]:
    """Map the arrays of an NPZ file into memory.

    The first mapping of a file in a process reads it once and compares its checksums.
    """
    with open(path, "rb") as stream, zipfile.ZipFile(stream) as archive:
        state = os.fstat(stream.fileno())
        _check_sums(os.path.abspath(path), state.st_size, state.st_mtime_ns)
        content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_COPY)
        return {entry.filename.removesuffix(".npy"): _map_entry(content, entry) for entry in archive.infolist()}


@functools.lru_cache(maxsize=256)
def _check_sums(path: str, size: int, modified: int) -> None:
    with (
        open(path, "rb") as stream,
        zipfile.ZipFile(stream) as archive,
        mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content,
        memoryview(content) as data,
    ):
        for entry in archive.infolist():
            begin = _data_offset(content, entry)
            end, found = begin + entry.compress_size, 0
            for at in range(begin, end, _BLOCK):
                found = zlib.crc32(data[at : min(at + _BLOCK, end)], found)
            if entry.compress_type == zipfile.ZIP_STORED and found != entry.CRC:
                raise ValueError(f"{entry.filename} differs from its checksum")


def _data_offset(content: mmap.mmap, entry: zipfile.ZipInfo) -> int:
    lengths = _LOCAL_HEADER.unpack_from(content, entry.header_offset)
    return int(entry.header_offset + _LOCAL_HEADER.size + sum(lengths))


def _map_entry(content: mmap.mmap, entry: zipfile.ZipInfo) -> NDArray:
    if entry.compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"{entry.filename} is compressed")
    start = _data_offset(content, entry)
    content.seek(start)
    version = np.lib.format.read_magic(content)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran_order, dtype = read_header(content)
    if dtype.hasobject:
        raise ValueError(f"{entry.filename} holds Python objects")
    size = int(np.prod(shape)) * dtype.itemsize
    if content.tell() + size > start + entry.file_size:
        raise ValueError(f"{entry.filename} ends early")
    if size == 0:
        return np.empty(shape, dtype)
    return np.ndarray(shape, dtype, buffer=content, offset=content.tell(), order="F" if fortran_order else "C")


POINTS, ARRAYS, TABLE = "points", "arrays", "table"
EXTENSIONS = {POINTS: "parquet", ARRAYS: "npz", TABLE: "parquet"}
SINGLE = "result"
"""Part name of a result that is not divided into parts."""

_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]*")
_CSR_FIELDS = ("data", "indices", "indptr", "shape")
# Of the measured encodings, byte stream split with zstd writes floating-point columns fastest, at half their size.
_COMPRESSION = {"compression": "zstd", "compression_level": 1}
_SCHEMA_KEY = b"mlsroad"
_GROUP = 1 << 19  # points
_SAMPLE = 4096


def is_valid_name(name: object) -> bool:
    """Return whether a name suits a scene or a part: letters, digits, `_`, `.` and `-`, no leading dot."""
    return isinstance(name, str) and _NAME.fullmatch(name) is not None


def kind_of(value: object) -> str | None:
    """Return the kind of file for a value, or None if there is none."""
    pandas = sys.modules.get("pandas")  # a table exists only if pandas has been imported
    if isinstance(value, PointCloud):
        return POINTS
    if pandas is not None and isinstance(value, pandas.DataFrame):
        return TABLE
    if isinstance(value, Mapping) and all(isinstance(v, np.ndarray) or _is_csr(v) for v in value.values()):
        return ARRAYS
    return None


def _is_csr(value: object) -> bool:
    return sparse.issparse(value) and isinstance(value, sparse.csr_array)


class ResultPart(NamedTuple):
    """Part of a result: the kind of its file (a key of `EXTENSIONS`) and its value."""

    kind: str
    value: Any


def split_parts(result: object) -> dict[str, ResultPart]:
    """Divide a result into named parts, one file each."""
    kind = kind_of(result)
    if kind is not None:
        return {SINGLE: ResultPart(kind, result)}
    if not isinstance(result, Mapping):
        raise DataError(f"a scene's result must be a PointCloud, a DataFrame or a mapping, got {type(result).__name__}")
    parts = {}
    for name, value in result.items():
        if not is_valid_name(name) or name == SINGLE:
            raise DataError(f"a part of a result cannot be called {name!r}")
        part_kind = kind_of(value)
        if part_kind is None:
            raise DataError(f"part {name!r} of a result cannot be stored: it is a {_type_name(value)}")
        parts[name] = ResultPart(part_kind, value)
    return parts


def _type_name(value: object) -> str:
    if isinstance(value, Mapping):
        return "mapping with " + ", ".join(f"{name!r}: {type(item).__name__}" for name, item in value.items())
    return type(value).__name__


def write_part(kind: str, value: Any, stream: BinaryIO | RawIOBase) -> None:
    """Write a value to a stream; raise DataError for a dtype that cannot be stored without loss."""
    if kind == POINTS:
        _write_points(value, stream)
    else:
        (_write_arrays if kind == ARRAYS else _write_table)(value, stream)


def read_part(kind: str, source: str | BinaryIO, *, mapped: bool = False) -> Any:
    """Read a value written by `write_part`."""
    if kind == POINTS:
        return _read_points(source)
    return _read_arrays(source, mapped=mapped) if kind == ARRAYS else _read_table(source)


def _unique_name(name: str, taken: list[str]) -> str:
    while name in taken:
        name += "_"
    return name


def _flat_columns(cloud: PointCloud) -> tuple[list[dict[str, Any]], list[str], list[NDArray]]:
    """Split vector columns into scalar ones, which other programs read and which compress better than lists.

    Returns the layout of the original columns (JSON data), and the names and values of the scalar ones.
    """
    layout: list[dict[str, Any]] = []
    names: list[str] = []
    arrays: list[NDArray] = []
    for name, values in [(None, cloud.xyz), *cloud.columns.items()]:
        array = np.asarray(values)
        if array.dtype.kind not in "biuf" or array.dtype.itemsize > 8:
            raise DataError(f"{cloud.source}: column {name!r} of dtype {array.dtype} cannot be stored")
        flat = array.reshape(len(array), math.prod(array.shape[1:]))
        fields = []
        for i in range(flat.shape[1]):
            field = "xyz"[i] if name is None else name if array.ndim == 1 else f"{name}[{i}]"
            fields.append(_unique_name(field, names))
            names.append(fields[-1])
            arrays.append(flat[:, i])
        layout.append({"name": name, "dtype": array.dtype.str, "shape": list(array.shape[1:]), "fields": fields})
    return layout, names, arrays


def _has_many_values(array: NDArray) -> bool:
    """Return False for floating-point columns with few values (8-bit intensities), which suit a dictionary."""
    if array.dtype.kind != "f":
        return False
    sample = array[:: max(1, len(array) // _SAMPLE)]
    return len(np.unique(sample)) > len(sample) // 8


def _write_points(cloud: PointCloud, stream: BinaryIO | RawIOBase) -> None:
    layout, names, arrays = _flat_columns(cloud)
    header = {
        "origin": np.asarray(cloud.origin, dtype=np.float64).tolist(),
        "crs": cloud.crs,
        "source": cloud.source,
        "columns": layout,
    }
    types = [array.dtype.newbyteorder("=") for array in arrays]
    fields = [pa.field(name, pa.from_numpy_dtype(dtype)) for name, dtype in zip(names, types, strict=True)]
    schema = pa.schema(fields, metadata={_SCHEMA_KEY: json.dumps(header)})
    split = [name for name, array in zip(names, arrays, strict=True) if _has_many_values(array)]
    with pq.ParquetWriter(
        stream,
        schema,
        use_dictionary=[name for name in names if name not in split],
        column_encoding={name: "BYTE_STREAM_SPLIT" for name in split},
        write_statistics=False,
        write_page_checksum=True,
        **_COMPRESSION,
    ) as writer:
        # Row group by row group: besides the cloud, memory holds at most one group.
        for start in range(0, max(len(cloud), 1), _GROUP):
            rows = slice(start, start + _GROUP)
            group = [np.ascontiguousarray(a[rows], dtype=t) for a, t in zip(arrays, types, strict=True)]
            writer.write_table(pa.table([pa.array(values) for values in group], schema=schema))


def _read_points(source: str | BinaryIO) -> PointCloud:
    file = pq.ParquetFile(source, page_checksum_verification=True, pre_buffer=False)
    header = json.loads(file.schema_arrow.metadata[_SCHEMA_KEY])
    n, layout = file.metadata.num_rows, header["columns"]
    # Copied into own arrays: arrays of Arrow are read-only, which Numba and PyTorch treat as another type.
    arrays = [np.empty((n, len(column["fields"])), dtype=np.dtype(column["dtype"])) for column in layout]
    start = 0
    for group in range(file.num_row_groups):
        table = file.read_row_group(group, use_threads=False)
        for column, array in zip(layout, arrays, strict=True):
            for i, field in enumerate(column["fields"]):
                array[start : start + len(table), i] = table[field].to_numpy()
        start += len(table)
    shaped = [array.reshape(n, *column["shape"]) for column, array in zip(layout, arrays, strict=True)]
    columns = {column["name"]: array for column, array in zip(layout[1:], shaped[1:], strict=True)}
    xyz = shaped[0]
    return PointCloud(xyz, columns, np.array(header["origin"]), header["crs"], header["source"])


def _write_arrays(arrays: Mapping[str, Any], stream: BinaryIO | RawIOBase) -> None:
    # Stored without compression: zipfile has no zstd, and deflate is slower than a disk. Entries carry no date.
    with zipfile.ZipFile(cast(BinaryIO, stream), "w", zipfile.ZIP_STORED) as archive:
        for name, value in arrays.items():
            if not isinstance(name, str) or not name or "/" in name:
                raise DataError(f"an array cannot be called {name!r}")
            if _is_csr(value):
                fields = {f"{name}/{field}": np.asarray(getattr(value, field)) for field in _CSR_FIELDS}
            else:
                fields = {name: value}
            for entry, array in fields.items():
                if array.dtype.hasobject:
                    raise DataError(f"array {entry!r} of dtype {array.dtype} cannot be stored")
                with archive.open(zipfile.ZipInfo(f"{entry}.npy"), "w", force_zip64=True) as target:
                    np.lib.format.write_array(target, array, allow_pickle=False)


def _read_arrays(source: str | BinaryIO, *, mapped: bool) -> dict[str, Any]:
    if mapped and isinstance(source, str):
        entries = map_arrays(source)
    else:
        with np.load(source, allow_pickle=False) as archive:
            entries = {name: archive[name] for name in archive.files}
    arrays: dict[str, Any] = {}
    for entry, array in entries.items():
        name, _, field = entry.partition("/")
        if not field:
            arrays[name] = array
        elif name not in arrays:
            data, indices, indptr, shape = (entries[f"{name}/{f}"] for f in _CSR_FIELDS)
            arrays[name] = sparse.csr_array((data, indices, indptr), shape=tuple(shape.tolist()))
    return arrays


def _write_table(frame: Any, stream: BinaryIO | RawIOBase) -> None:
    try:
        table = pa.Table.from_pandas(frame, nthreads=1)
    except (pa.ArrowException, TypeError, ValueError) as error:
        raise DataError(f"a table cannot be stored: {error}") from error
    pq.write_table(table, stream, write_page_checksum=True, **_COMPRESSION)


def _read_table(source: str | BinaryIO) -> Any:
    file = pq.ParquetFile(source, page_checksum_verification=True, pre_buffer=False)
    return file.read(use_threads=False, use_pandas_metadata=True).to_pandas(use_threads=False)
