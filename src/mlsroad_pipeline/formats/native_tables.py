"""Copies of PCD, Parquet and NPZ files in their own format, with class, confidence and object added."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.content import BLOCK, open_content
from mlsroad_pipeline.formats.labelled_names import CLASS, CONFIDENCE, OBJECT, RESULTS, PointLabels, kept_name
from mlsroad_pipeline.formats.npz import EPOCH
from mlsroad_pipeline.formats.parquet import GROUP
from mlsroad_pipeline.formats.pcd.format import PcdFormat
from mlsroad_pipeline.formats.pcd.header import PADDING, PcdHeader, read_pcd_header

# Fields added to a PCD header; those of four bytes come first, where they are aligned.
ADDED = {"FIELDS": f"{CONFIDENCE} {OBJECT} {CLASS}", "SIZE": "4 4 1", "TYPE": "F U U", "COUNT": "1 1 1"}
DTYPES = (np.uint8, np.float32, np.uint32)  # types of the columns of `RESULTS`


def can_hold(source: Path, form: str) -> bool:
    """Return whether this module can add labels to a file of a format.

    True for Parquet (not one named like the inventory), NPZ (not NPY), and binary PCD without padding, whose offsets
    are uncertain, and without beams that did not return.
    """
    if form == "PCD":
        header = read_pcd_header(source)
        packed = all(field.name != PADDING for field in header.fields)
        return (
            packed
            and header.encoding == "binary"
            and PcdFormat().open_table(source, ReadOptions()).n_points == header.n_points
        )
    return (form == "Parquet" and source.name != "inventory.parquet") or (form == "NPZ" and zipfile.is_zipfile(source))


class TableSink(Protocol):
    """Sink of labels of consecutive ranges, closed after the last one."""

    def write(self, start: int, labels: PointLabels) -> None:
        """Write the points from row `start`."""

    def finish(self) -> None:
        """Write the content after the points."""


class _ParquetSink:
    """Writer of Parquet that adds three columns, a batch at a time; the schema's metadata are kept."""

    def __init__(self, source: Path, out: BinaryIO) -> None:
        file = pq.ParquetFile(source)
        old = file.schema_arrow
        fields = [f.with_name(kept_name(f.name, old.names)) if f.name in RESULTS else f for f in old]
        added = [pa.field(name, pa.from_numpy_dtype(dtype)) for name, dtype in zip(RESULTS, DTYPES, strict=True)]
        self._schema = pa.schema([*fields, *added], metadata=old.metadata)
        self._batches = file.iter_batches(batch_size=GROUP, use_threads=False)
        self._rest = pa.RecordBatch.from_pylist([], schema=old)
        self._writer = pq.ParquetWriter(out, self._schema, compression="zstd", write_page_checksum=True)

    def write(self, start: int, labels: PointLabels) -> None:
        """Write the points from row `start`."""
        done, n = 0, len(labels.codes)
        while done < n:
            batch = self._rest if self._rest.num_rows else next(self._batches)
            n_rows = min(batch.num_rows, n - done)
            part, self._rest = batch.slice(0, n_rows), batch.slice(n_rows)
            added = [pa.array(values[done : done + n_rows]) for values in labels.columns().values()]
            self._writer.write_batch(pa.record_batch([*part.columns, *added], schema=self._schema))
            done += n_rows

    def finish(self) -> None:
        """Write the end of the file."""
        self._writer.close()


class _NpzSink:
    """Writer of NPZ that adds three arrays; the others are copied."""

    def __init__(self, source: Path, out: BinaryIO) -> None:
        self._source, self._out = source, out
        self._parts: dict[str, list[NDArray]] = {name: [] for name in RESULTS}

    def write(self, start: int, labels: PointLabels) -> None:
        """Keep the labels from row `start`."""
        for name, values in labels.columns().items():
            self._parts[name].append(values)

    def finish(self) -> None:
        """Write the archive."""
        with zipfile.ZipFile(self._source) as old, zipfile.ZipFile(self._out, "w", zipfile.ZIP_DEFLATED) as new:
            names = [entry.filename.removesuffix(".npy") for entry in old.infolist()]
            for entry, name in zip(old.infolist(), names, strict=True):
                kept = f"{kept_name(name, names)}.npy" if name in self._parts else entry.filename
                with old.open(entry) as stream, new.open(_entry(kept), "w", force_zip64=True) as target:
                    shutil.copyfileobj(stream, target, BLOCK)
            for (name, parts), dtype in zip(self._parts.items(), DTYPES, strict=True):
                with new.open(_entry(f"{name}.npy"), "w", force_zip64=True) as target:
                    np.lib.format.write_array(target, np.concatenate([np.empty(0, dtype), *parts]))


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, EPOCH)  # no date: same points, same bytes
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry


class _PcdSink:
    """Writer of binary PCD that adds three fields to the records; other header lines are kept."""

    def __init__(self, source: Path, out: BinaryIO) -> None:
        self._file, self._header, self._out = open_content(source), read_pcd_header(source), out
        out.write(_labelled_head(self._file.read(self._header.begin), self._header))

    def write(self, start: int, labels: PointLabels) -> None:
        """Write the points from row `start`."""
        size, n = self._header.dtype.itemsize, len(labels.codes)
        old = self._file.records(np.dtype("u1"), self._header.begin + start * size, n * size)
        added = [(CONFIDENCE, "<f4"), (OBJECT, "<u4"), (CLASS, "u1")]
        new = np.empty(n, dtype=[("old", "u1", (size,)), *added])
        new["old"] = old.reshape(n, size)
        for name, values in labels.columns().items():
            new[name] = values
        self._out.write(new.tobytes())

    def finish(self) -> None:
        """Nothing follows the points."""


def _labelled_head(text: bytes, header: PcdHeader) -> bytes:
    names = [field.name for field in header.fields]
    lines = []
    for line in text.decode("utf-8", "replace").splitlines():
        key, *values = line.split() or [""]
        entry = "FIELDS" if key.upper() == "COLUMNS" else key.upper()
        if entry == "FIELDS":
            values = [kept_name(name, names) if name in RESULTS else name for name in values]
        lines.append(" ".join([key, *values, ADDED[entry]]) if entry in ADDED else line)
    return ("\n".join(lines) + "\n").encode()


# Format to the writer of its copies; arguments: the file and an output stream.
SINKS: dict[str, Callable[[Path, BinaryIO], TableSink]] = {"Parquet": _ParquetSink, "NPZ": _NpzSink, "PCD": _PcdSink}
