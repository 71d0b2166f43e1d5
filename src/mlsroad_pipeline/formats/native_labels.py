"""Copies of PLY, PCD, text, Parquet, NPZ and KITTI surveys in their own format, with class, confidence and object."""

import re
import shutil
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.formats.base import PointFormat, ReadOptions
from mlsroad_pipeline.formats.files import BLOCK, open_content, output_file
from mlsroad_pipeline.formats.kitti import label_path
from mlsroad_pipeline.formats.labelled_names import CLASS, CONFIDENCE, OBJECT, RESULTS, PointLabels, kept_name
from mlsroad_pipeline.formats.npz import archive_entry
from mlsroad_pipeline.formats.parquet import GROUP
from mlsroad_pipeline.formats.pcd.format import PcdFormat
from mlsroad_pipeline.formats.pcd.header import PADDING, PcdHeader, read_pcd_header
from mlsroad_pipeline.formats.ply.format import PlyFormat, vertex_rows
from mlsroad_pipeline.formats.ply.header import PlyHeader, read_ply_header
from mlsroad_pipeline.formats.text.format import TextFormat, TextTable, open_table
from mlsroad_pipeline.formats.text.sniffing import decoded
from mlsroad_pipeline.formats.text.values import WHITESPACE, TextRows, join_rows, number_text

# Fields added to a PCD header; those of four bytes come first, where they are aligned.
PCD_FIELDS = {"FIELDS": f"{CONFIDENCE} {OBJECT} {CLASS}", "SIZE": "4 4 1", "TYPE": "F U U", "COUNT": "1 1 1"}
DTYPES = (np.uint8, np.float32, np.uint32)  # types of the columns of `RESULTS`


class LabelSink(ABC):
    """Sink of labels of consecutive ranges that writes the points of the source with them."""

    @abstractmethod
    def write(self, start: int, labels: PointLabels) -> None:
        """Write the points from row `start`."""

    def finish(self) -> None:  # noqa: B027  # most formats end with the points
        """Write what follows the points."""


def native_path(source: Path, folder: Path, form: PointFormat) -> Path | None:
    """Return the path of the copy in a survey's own format in the folder of the results.

    KITTI: the ``.label`` of that name; others: the same file name. None where the format cannot hold labels (E57, NPY),
    for a PLY file whose vertices are not first or hold lists, and for PCD that is not binary, has padding, or has beams
    without return. `DataError` if the copy would overwrite the survey or its present labels.
    """
    if form.name == "KITTI":
        target = folder / f"{source.stem}.label"
        if target.exists() and label_path(source) is not None and target.samefile(cast(Path, label_path(source))):
            raise DataError(f"{target} holds the labels of {source} and would be overwritten; choose another folder")
        return target
    is_ply = isinstance(form, PlyFormat) and read_ply_header(source).vertex_first
    if isinstance(form, TextFormat) or is_ply or _can_hold(source, form.name):
        target = folder / source.name
        if target.exists() and target.samefile(source):
            raise DataError(f"{target} is the survey itself and would be overwritten; choose another folder")
        return target
    return None


def _can_hold(source: Path, form: str) -> bool:
    """Return whether labels can be added to a file.

    True for Parquet (not one named like the inventory), NPZ (not NPY), and binary PCD without padding, whose offsets
    are uncertain, and without beams that did not return.
    """
    if form == "PCD":
        header = read_pcd_header(source)
        whole = header.encoding == "binary" and all(field.name != PADDING for field in header.fields)
        return whole and PcdFormat().open_table(source, ReadOptions()).n_points == header.n_points
    return (form == "Parquet" and source.name != "inventory.parquet") or (form == "NPZ" and zipfile.is_zipfile(source))


@contextmanager
def native_sink(source: Path, target: Path, form: PointFormat, options: ReadOptions) -> Iterator[LabelSink]:
    """Yield a sink that writes the copy in the survey's own format; the file appears when the block ends."""
    with output_file(target) as stream:
        sink = SINKS[form.name](source, options, stream)
        yield sink
        sink.finish()


def _with_labels(old: NDArray[np.uint8], labels: PointLabels, added: list[tuple[str, str]]) -> NDArray:
    """Return records, given as bytes one after another, with fields for labels behind their own."""
    n = len(labels.codes)
    new = np.empty(n, dtype=[("old", "u1", (len(old) // max(n, 1),)), ("added", added)])
    new["old"] = old.reshape(new["old"].shape)
    for name, values in labels.columns().items():
        new["added"][name] = values
    return new


class _TextSink(LabelSink):
    """Writer of text that appends three values to every row; the text of the row is kept."""

    def __init__(self, source: Path, options: ReadOptions, out: BinaryIO) -> None:
        table = open_table(source, options)
        self._rows, self._out = table.rows, out
        self._delimiter = " " if table.form.delimiter == WHITESPACE else table.form.delimiter
        lines = list(table.head)
        if table.names_at >= 0:
            lines[table.names_at] = self._with_results(lines[table.names_at], table)
        self._out.write(b"".join(lines))

    def _with_results(self, line: bytes, table: TextTable) -> bytes:
        """Return the line of the names with those of the results, in its own separator and encoding."""
        names, encoding = decoded(line)
        separator = next((mark for mark in "\t;," if mark in names), self._delimiter)
        for name in RESULTS:
            if name in table.names:
                names = re.sub(rf"\b{name}\b", kept_name(name, table.names), names)
        blank = [""] * (table.names[-1] == "" and not names.rstrip().endswith(separator))
        return (separator.join([names, *blank, *RESULTS]) + "\n").encode(encoding)

    def write(self, start: int, labels: PointLabels) -> None:
        rows = _lines(self._rows, start, len(labels.codes))
        self._out.write(join_rows([rows, *map(number_text, labels.columns().values())], self._delimiter))


def _lines(rows: TextRows, start: int, count: int) -> pa.Array:
    """Return rows as an array of text without line ends, built from their byte offsets."""
    data = np.frombuffer(rows.read(start, start + count), dtype=np.uint8)
    ends = np.flatnonzero(data == ord("\n"))
    if len(ends) < count:
        ends = np.append(ends, len(data))
    returns = np.flatnonzero(data == ord("\r"))
    keep = data != ord("\n")
    keep[returns] = False
    dropped = np.arange(count) + np.searchsorted(returns, ends)  # line ends before each row's end
    offsets = np.concatenate([[0], ends - dropped]).astype(np.int32)
    return pa.StringArray.from_buffers(count, pa.py_buffer(offsets.tobytes()), pa.py_buffer(data[keep].tobytes()))


class _PlySink(LabelSink):
    """Writer of PLY that adds three properties to the vertices; other header lines and elements are copied."""

    def __init__(self, source: Path, options: ReadOptions, out: BinaryIO) -> None:
        self._file, self._header, self._out = open_content(source), read_ply_header(source), out
        self._rows = vertex_rows(source, self._header) if self._header.encoding == "ascii" else None
        self._size = self._header.vertex.dtype(self._header.order).itemsize
        out.write(_labelled_ply_head(self._header))

    def write(self, start: int, labels: PointLabels) -> None:
        n = len(labels.codes)
        if self._rows is not None:
            rows = _lines(self._rows, start, n)
            self._out.write(join_rows([rows, *map(number_text, labels.columns().values())], " "))
            return
        order = self._header.order
        old = self._file.records(np.dtype("u1"), self._header.begin + start * self._size, n * self._size)
        added = [(CLASS, "u1"), (CONFIDENCE, order + "f4"), (OBJECT, order + "u4")]
        self._out.write(_with_labels(old, labels, added).tobytes())

    def finish(self) -> None:
        end = self._header.begin + self._header.vertex.count * self._size if self._rows is None else self._rows.end
        while data := self._file.read(BLOCK, end):
            self._out.write(data)
            end += len(data)


def _labelled_ply_head(header: PlyHeader) -> bytes:
    line_end = "\r\n" if header.text.startswith(b"ply\r\n") else chr(header.text[3])
    text = header.text.decode("utf-8", "surrogateescape")  # comments may have another encoding
    lines = [line + line_end for line in text.split(line_end)[:-1]]
    inside, last = False, 0
    for at, line in enumerate(lines):
        words = line.split()
        if words[:1] == ["element"]:
            inside = words[1] == "vertex"
        if inside and words[:1] in (["element"], ["property"]):
            last = at
            if words[-1] in RESULTS and words[0] == "property":
                kept = kept_name(words[-1], list(header.vertex.properties))
                lines[at] = " ".join([*words[:-1], kept]) + line_end
    types = zip(("uchar", "float", "uint"), RESULTS, strict=True)
    added = [f"property {kind} {name}{line_end}" for kind, name in types]
    return "".join([*lines[: last + 1], *added, *lines[last + 1 :]]).encode("utf-8", "surrogateescape")


class _KittiSink(LabelSink):
    """Writer of KITTI labels: classes in the lower 16 bits; the instances of the survey are kept."""

    def __init__(self, source: Path, options: ReadOptions, out: BinaryIO) -> None:
        labels, self._out = label_path(source), out
        self._old = np.fromfile(labels, dtype="<u4") if labels is not None else None

    def write(self, start: int, labels: PointLabels) -> None:
        packed = labels.codes.astype("<u4")
        if self._old is not None:
            packed |= self._old[start : start + len(packed)] & np.uint32(0xFFFF0000)
        self._out.write(packed.astype("<u4").tobytes())


class _ParquetSink(LabelSink):
    """Writer of Parquet that adds three columns, a batch at a time; the schema's metadata are kept."""

    def __init__(self, source: Path, options: ReadOptions, out: BinaryIO) -> None:
        file = pq.ParquetFile(source)
        old = file.schema_arrow
        fields = [f.with_name(kept_name(f.name, old.names)) if f.name in RESULTS else f for f in old]
        added = [pa.field(name, pa.from_numpy_dtype(dtype)) for name, dtype in zip(RESULTS, DTYPES, strict=True)]
        self._schema = pa.schema([*fields, *added], metadata=old.metadata)
        self._batches = file.iter_batches(batch_size=GROUP, use_threads=False)
        self._rest = pa.RecordBatch.from_pylist([], schema=old)
        self._writer = pq.ParquetWriter(out, self._schema, compression="zstd", write_page_checksum=True)

    def write(self, start: int, labels: PointLabels) -> None:
        done, n = 0, len(labels.codes)
        while done < n:
            batch = self._rest if self._rest.num_rows else next(self._batches)
            n_rows = min(batch.num_rows, n - done)
            part, self._rest = batch.slice(0, n_rows), batch.slice(n_rows)
            added = [pa.array(values[done : done + n_rows]) for values in labels.columns().values()]
            self._writer.write_batch(pa.record_batch([*part.columns, *added], schema=self._schema))
            done += n_rows

    def finish(self) -> None:
        self._writer.close()


class _NpzSink(LabelSink):
    """Writer of NPZ that adds three arrays; the others are copied."""

    def __init__(self, source: Path, options: ReadOptions, out: BinaryIO) -> None:
        self._source, self._out = source, out
        self._parts: dict[str, list[NDArray]] = {name: [] for name in RESULTS}

    def write(self, start: int, labels: PointLabels) -> None:
        for name, values in labels.columns().items():
            self._parts[name].append(values)

    def finish(self) -> None:
        with zipfile.ZipFile(self._source) as old, zipfile.ZipFile(self._out, "w", zipfile.ZIP_DEFLATED) as new:
            names = [entry.filename.removesuffix(".npy") for entry in old.infolist()]
            for entry, name in zip(old.infolist(), names, strict=True):
                kept = f"{kept_name(name, names)}.npy" if name in self._parts else entry.filename
                with old.open(entry) as stream, new.open(archive_entry(kept), "w", force_zip64=True) as target:
                    shutil.copyfileobj(stream, target, BLOCK)
            for (name, parts), dtype in zip(self._parts.items(), DTYPES, strict=True):
                with new.open(archive_entry(f"{name}.npy"), "w", force_zip64=True) as target:
                    np.lib.format.write_array(target, np.concatenate([np.empty(0, dtype), *parts]))


class _PcdSink(LabelSink):
    """Writer of binary PCD that adds three fields to the records; other header lines are kept."""

    def __init__(self, source: Path, options: ReadOptions, out: BinaryIO) -> None:
        self._file, self._header, self._out = open_content(source), read_pcd_header(source), out
        out.write(_labelled_pcd_head(self._file.read(self._header.begin), self._header))

    def write(self, start: int, labels: PointLabels) -> None:
        size, n = self._header.dtype.itemsize, len(labels.codes)
        old = self._file.records(np.dtype("u1"), self._header.begin + start * size, n * size)
        added = [(CONFIDENCE, "<f4"), (OBJECT, "<u4"), (CLASS, "u1")]
        self._out.write(_with_labels(old, labels, added).tobytes())


def _labelled_pcd_head(text: bytes, header: PcdHeader) -> bytes:
    names = [field.name for field in header.fields]
    lines = []
    for line in text.decode("utf-8", "replace").splitlines():
        key, *values = line.split() or [""]
        entry = "FIELDS" if key.upper() == "COLUMNS" else key.upper()
        if entry == "FIELDS":
            values = [kept_name(name, names) if name in RESULTS else name for name in values]
        lines.append(" ".join([key, *values, PCD_FIELDS[entry]]) if entry in PCD_FIELDS else line)
    return ("\n".join(lines) + "\n").encode()


# Format to the writer of its copies; arguments: the survey, options of reading it, and an output stream.
SINKS: dict[str, Callable[[Path, ReadOptions, BinaryIO], LabelSink]] = {
    **{"text": _TextSink, "PLY": _PlySink, "KITTI": _KittiSink},
    **{"Parquet": _ParquetSink, "NPZ": _NpzSink, "PCD": _PcdSink},
}
