"""Copies of PCD, Parquet and NPZ files in their own format, with class and confidence added."""

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
from mlsroad_pipeline.formats.labelled_names import CLASS, CONFIDENCE, kept_name
from mlsroad_pipeline.formats.npz import EPOCH
from mlsroad_pipeline.formats.parquet import GROUP
from mlsroad_pipeline.formats.pcd.format import PcdFormat
from mlsroad_pipeline.formats.pcd.header import PADDING, PcdHeader, read_pcd_header

ADDED = {"FIELDS": f"{CONFIDENCE} {CLASS}", "SIZE": "4 1", "TYPE": "F U", "COUNT": "1 1"}
"""Fields added to a PCD header; the float comes first, where it is aligned."""


def can_hold(source: Path, form: str) -> bool:
    """Return whether this module can add labels to a file.

    Parameters
    ----------
    source : Path
        The file.
    form : str
        Name of its format.

    Returns
    -------
    bool
        True for Parquet (not one named like the inventory), NPZ (not NPY), and binary PCD without padding, whose
        offsets are uncertain, and without beams that did not return.
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

    def write(self, start: int, codes: NDArray[np.uint8], confidence: NDArray[np.float32]) -> None:
        """Write the points from row `start`.

        Parameters
        ----------
        start : int
            Row of the first point.
        codes : ndarray of uint8, shape (n,)
            Classes.
        confidence : ndarray of float32, shape (n,)
            Confidences.
        """

    def finish(self) -> None:
        """Write the content after the points."""


class _ParquetSink:
    """Writer of Parquet that adds two columns, a batch at a time; the schema's metadata are kept."""

    def __init__(self, source: Path, out: BinaryIO) -> None:
        file = pq.ParquetFile(source)
        old = file.schema_arrow
        fields = [f.with_name(kept_name(f.name, old.names)) if f.name in (CLASS, CONFIDENCE) else f for f in old]
        added = [pa.field(CLASS, pa.uint8()), pa.field(CONFIDENCE, pa.float32())]
        self._schema = pa.schema([*fields, *added], metadata=old.metadata)
        self._batches = file.iter_batches(batch_size=GROUP, use_threads=False)
        self._rest = pa.RecordBatch.from_pylist([], schema=old)
        self._writer = pq.ParquetWriter(out, self._schema, compression="zstd", write_page_checksum=True)

    def write(self, start: int, codes: NDArray[np.uint8], confidence: NDArray[np.float32]) -> None:
        """Write the points from row `start`."""
        done = 0
        while done < len(codes):
            batch = self._rest if self._rest.num_rows else next(self._batches)
            n_rows = min(batch.num_rows, len(codes) - done)
            part, self._rest = batch.slice(0, n_rows), batch.slice(n_rows)
            labels = [pa.array(codes[done : done + n_rows]), pa.array(confidence[done : done + n_rows])]
            self._writer.write_batch(pa.record_batch([*part.columns, *labels], schema=self._schema))
            done += n_rows

    def finish(self) -> None:
        """Write the end of the file."""
        self._writer.close()


class _NpzSink:
    """Writer of NPZ that adds two arrays; the others are copied."""

    def __init__(self, source: Path, out: BinaryIO) -> None:
        self._source, self._out = source, out
        self._parts: dict[str, list[NDArray]] = {CLASS: [], CONFIDENCE: []}

    def write(self, start: int, codes: NDArray[np.uint8], confidence: NDArray[np.float32]) -> None:
        """Keep the labels from row `start`."""
        self._parts[CLASS].append(codes)
        self._parts[CONFIDENCE].append(confidence)

    def finish(self) -> None:
        """Write the archive."""
        with zipfile.ZipFile(self._source) as old, zipfile.ZipFile(self._out, "w", zipfile.ZIP_DEFLATED) as new:
            names = [entry.filename.removesuffix(".npy") for entry in old.infolist()]
            for entry, name in zip(old.infolist(), names, strict=True):
                kept = f"{kept_name(name, names)}.npy" if name in self._parts else entry.filename
                with old.open(entry) as stream, new.open(_entry(kept), "w", force_zip64=True) as target:
                    shutil.copyfileobj(stream, target, BLOCK)
            for (name, parts), dtype in zip(self._parts.items(), (np.uint8, np.float32), strict=True):
                with new.open(_entry(f"{name}.npy"), "w", force_zip64=True) as target:
                    np.lib.format.write_array(target, np.concatenate([np.empty(0, dtype), *parts]))


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, EPOCH)  # no date: same points, same bytes
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry


class _PcdSink:
    """Writer of binary PCD that adds two fields to the records; other header lines are kept."""

    def __init__(self, source: Path, out: BinaryIO) -> None:
        self._file, self._header, self._out = open_content(source), read_pcd_header(source), out
        out.write(_labelled_head(self._file.read(self._header.begin), self._header))

    def write(self, start: int, codes: NDArray[np.uint8], confidence: NDArray[np.float32]) -> None:
        """Write the points from row `start`."""
        size = self._header.record_size
        old = self._file.records(np.dtype("u1"), self._header.begin + start * size, len(codes) * size)
        new = np.empty((len(codes), size + 5), dtype=np.uint8)
        new[:, :size] = old.reshape(len(codes), size)
        new[:, size : size + 4] = np.ascontiguousarray(confidence, "<f4").view(np.uint8).reshape(-1, 4)
        new[:, size + 4] = codes
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
            values = [kept_name(name, names) if name in (CLASS, CONFIDENCE) else name for name in values]
        lines.append(" ".join([key, *values, ADDED[entry]]) if entry in ADDED else line)
    return ("\n".join(lines) + "\n").encode()


SINKS: dict[str, Callable[[Path, BinaryIO], TableSink]] = {"Parquet": _ParquetSink, "NPZ": _NpzSink, "PCD": _PcdSink}
"""Format to the writer of its copies; arguments: the file and an output stream."""
