"""Parquet tables of points."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.files import FileKey, atomic_file, check_expansion, file_key
from mlsroad_pipeline.formats.standard_columns import COLOURS
from mlsroad_pipeline.formats.tables import PointTable, TableFormat, scalar_columns

GROUP = 1 << 18  # rows of a row group, the smallest unit of reading
CRS_KEY = b"crs"
VECTORS = {"rgb": COLOURS, "xyz": ("x", "y", "z")}  # names of the parts of vectors that have names; others are numbered
logger = logging.getLogger(__name__)


PER_SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}  # units of times in a second
DAY = 86_400.0  # seconds of a day


@dataclass(frozen=True)
class _Column:
    """A column of the table, or one index of a column of lists of fixed length."""

    source: str
    index: int | None
    dtype: np.dtype


class ParquetFormat(TableFormat):
    """Reader and writer of Parquet.

    Numbers keep their types; logical values become uint8, dates seconds since 1970 in float64, durations and times of
    day seconds, and lists of fixed length numbered columns. A missing integer makes its column float64 with NaN.
    Columns of text are left out and logged. A CRS is kept as WKT in the schema's metadata under ``crs``.
    """

    name = "Parquet"
    extensions: tuple[str, ...] = (".parquet",)
    signatures: tuple[bytes, ...] = (b"PAR1",)

    def open_table(self, path: Path, options: ReadOptions) -> PointTable:
        """Open a file."""
        return _open(file_key(path))

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write a cloud, compressed with zstd, with world coordinates in float64."""
        empty = scalar_columns(cloud.select(np.arange(0)), options.metres)
        fields = [pa.field(name, pa.from_numpy_dtype(values.dtype)) for name, values in empty.items()]
        schema = pa.schema(fields, metadata={CRS_KEY: cloud.crs.encode()} if cloud.crs else None)
        with (
            atomic_file(Path(path)) as stream,
            pq.ParquetWriter(stream, schema, compression="zstd", write_page_checksum=True) as writer,
        ):
            for start in range(0, max(len(cloud), 1), GROUP):
                part = cloud.select(np.arange(start, min(start + GROUP, len(cloud))))
                columns = [pa.array(np.ascontiguousarray(v)) for v in scalar_columns(part, options.metres).values()]
                writer.write_table(pa.table(columns, schema=schema))


@lru_cache(maxsize=8)
def _open(key: FileKey) -> PointTable:
    path = Path(key[0])
    try:
        file = pq.ParquetFile(path, page_checksum_verification=True, pre_buffer=False)
        schema, n_groups = file.schema_arrow, file.num_row_groups
        sizes = [file.metadata.row_group(group).num_rows for group in range(n_groups)]
    except (pa.ArrowException, OSError, ValueError) as error:
        raise ReadError(f"{path} is damaged: {error}") from error
    if min(sizes, default=0) < 0 or sum(sizes) != file.metadata.num_rows:
        raise ReadError(f"{path} is damaged: row groups of {sizes} rows in a file of {file.metadata.num_rows}")
    try:
        columns, written_by = _columns(schema, path), file.metadata.created_by
    except ValueError as error:  # names that are not valid text
        raise ReadError(f"{path} is damaged: {error}") from error
    check_expansion(path, sum(sizes) * sum(column.dtype.itemsize for column in columns.values()), path.stat().st_size)
    ends = np.cumsum(sizes, dtype=np.int64)

    def rows(names: Sequence[str], start: int, stop: int) -> Mapping[str, NDArray]:
        stop = max(start, stop)
        selected = [columns[name] for name in names]
        groups = range(int(np.searchsorted(ends, start, "right")), int(np.searchsorted(ends, stop)) + (stop > start))
        table = _read(file, list(groups), sorted({column.source for column in selected}), path)
        first = int(ends[groups[0]] - sizes[groups[0]]) if groups else start
        table = table.slice(start - first, stop - start)
        return {name: _values(table[column.source], column) for name, column in zip(names, selected, strict=True)}

    crs = (schema.metadata or {}).get(CRS_KEY)
    details = {"row_groups": n_groups, "written_by": written_by}
    return PointTable(tuple(columns), sum(sizes), rows, crs.decode("utf-8", "replace") if crs else None, details)


def _columns(schema: pa.Schema, path: Path) -> dict[str, _Column]:
    columns, lost = {}, []
    for field in schema:
        if pa.types.is_fixed_size_list(field.type) and _dtype(field.type.value_type) is not None:
            width = field.type.list_size
            parts = VECTORS.get(field.name.lower(), ())
            for i in range(width):
                name = parts[i] if len(parts) == width else f"{field.name}_{i}"
                columns[name] = _Column(field.name, i, _known(field.type.value_type))
        elif _dtype(field.type) is not None:
            columns[field.name] = _Column(field.name, None, _known(field.type))
        else:
            lost.append(field.name)
    if lost:
        logger.info("%s: columns that hold no numbers are left out: %s", path, ", ".join(lost))
    return columns


def _dtype(kind: pa.DataType) -> np.dtype | None:
    if pa.types.is_boolean(kind):
        return np.dtype("u1")
    if pa.types.is_decimal(kind) or (pa.types.is_temporal(kind) and not pa.types.is_interval(kind)):
        return np.dtype("f8")
    if pa.types.is_integer(kind) or pa.types.is_floating(kind):
        return np.dtype(kind.to_pandas_dtype())
    return None


def _known(kind: pa.DataType) -> np.dtype:
    dtype = _dtype(kind)
    assert dtype is not None
    return dtype


def _seconds(array: pa.Array) -> NDArray[np.float64]:
    """Return times as seconds: dates since 1970, others since midnight or as durations."""
    kind = array.type
    whole = array.cast(pa.int32() if kind.bit_width == 32 else pa.int64()).to_numpy(zero_copy_only=False)
    if pa.types.is_date(kind):
        return np.asarray(whole * DAY if pa.types.is_date32(kind) else whole / PER_SECOND["ms"])
    return np.asarray(whole / PER_SECOND[kind.unit])


def _read(file: pq.ParquetFile, groups: list[int], columns: list[str], path: Path) -> pa.Table:
    try:
        if not groups:
            return file.schema_arrow.empty_table().select(columns)
        return file.read_row_groups(groups, columns=columns, use_threads=False)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise ReadError(f"{path} is damaged in row groups {groups[0]} to {groups[-1]}: {error}") from error


def _values(column: pa.ChunkedArray, entry: _Column) -> NDArray:
    array = column.combine_chunks()
    if entry.index is not None:
        array = pa.compute.list_element(array, entry.index)
    if pa.types.is_temporal(array.type):
        return _seconds(array)
    if pa.types.is_decimal(array.type):
        array = array.cast(pa.float64())
    values = array.to_numpy(zero_copy_only=False)
    if values.dtype == object:  # logical values with gaps
        values = array.cast(pa.uint8()).to_numpy(zero_copy_only=False)
    return np.ascontiguousarray(values.astype(np.uint8) if values.dtype == np.bool_ else values)
