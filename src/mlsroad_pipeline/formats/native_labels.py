"""Copies of PLY, text and KITTI surveys in their own format, with class, confidence and object added."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Protocol, cast

import numpy as np
import pyarrow as pa

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.formats.base import PointFormat, ReadOptions
from mlsroad_pipeline.formats.content import BLOCK, open_content, output_file
from mlsroad_pipeline.formats.kitti import label_path
from mlsroad_pipeline.formats.labelled_names import CLASS, CONFIDENCE, OBJECT, RESULTS, PointLabels, kept_name
from mlsroad_pipeline.formats.native_tables import SINKS, can_hold
from mlsroad_pipeline.formats.ply.format import PlyFormat, vertex_rows
from mlsroad_pipeline.formats.ply.header import PlyHeader, read_ply_header
from mlsroad_pipeline.formats.text.format import TextFormat
from mlsroad_pipeline.formats.text.layout import TextTable, decoded, open_table
from mlsroad_pipeline.formats.text.rows import TextRows
from mlsroad_pipeline.formats.text.values import WHITESPACE, join_rows, number_text


class LabelSink(Protocol):
    """Sink of labels of consecutive ranges that writes the points of the source with them."""

    def write(self, start: int, labels: PointLabels) -> None:
        """Write the points from row `start`."""


def native_path(source: Path, folder: Path, form: PointFormat) -> Path | None:
    """Return the path of the copy in a survey's own format.

    Parameters
    ----------
    source : Path
        The survey; `DataError` if the copy would overwrite it or its present labels.
    folder : Path
        The folder of the results.
    form : PointFormat
        Its format.

    Returns
    -------
    Path or None
        KITTI: the ``.label`` of that name in `folder`; others: the same file name there. None where the format cannot
        hold labels (E57, NPY), for a PLY file whose vertices are not first or hold lists, and for PCD that is not
        binary, has padding, or has beams without return.
    """
    if form.name == "KITTI":
        target = folder / f"{source.stem}.label"
        if target.exists() and label_path(source) is not None and target.samefile(cast(Path, label_path(source))):
            raise DataError(f"{target} holds the labels of {source} and would be overwritten; choose another folder")
        return target
    is_ply = isinstance(form, PlyFormat) and read_ply_header(source).vertex_first
    if isinstance(form, TextFormat) or is_ply or can_hold(source, form.name):
        target = folder / source.name
        if target.exists() and target.samefile(source):
            raise DataError(f"{target} is the survey itself and would be overwritten; choose another folder")
        return target
    return None


@contextmanager
def native_sink(source: Path, target: Path, form: PointFormat, options: ReadOptions) -> Iterator[LabelSink]:
    """Yield a sink that writes the copy in the survey's own format; the file appears when the block ends.

    Parameters
    ----------
    source : Path
        The survey.
    target : Path
        See `native_path`.
    form : PointFormat
        Its format.
    options : ReadOptions
        Options of reading.
    """
    with output_file(target) as stream:
        if isinstance(form, TextFormat):
            yield _TextSink(source, options, stream)
        elif isinstance(form, PlyFormat):
            sink = _PlySink(source, stream)
            yield sink
            sink.copy_rest()
        elif form.name in SINKS:
            table = SINKS[form.name](source, stream)
            yield table
            table.finish()
        else:
            yield _KittiSink(source, stream)


class _TextSink:
    """Writer of text that appends three values to every row; the text of the row is kept."""

    def __init__(self, source: Path, options: ReadOptions, out: BinaryIO) -> None:
        table = open_table(source, options)
        self._rows, self._out = table.rows, out
        self._delimiter = " " if table.delimiter == WHITESPACE else table.delimiter
        lines = list(table.head.lines)
        if table.has_names:
            lines[table.head.names_at] = self._with_results(lines[table.head.names_at], table)
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
        """Write the points from row `start`."""
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


class _PlySink:
    """Writer of PLY that adds three properties to the vertices; other header lines and elements are copied."""

    def __init__(self, source: Path, stream: BinaryIO) -> None:
        self._source, self._stream = source, stream
        self._header = read_ply_header(source)
        self._rows = vertex_rows(source, self._header) if self._header.encoding == "ascii" else None
        stream.write(_labelled_head(self._header))

    def write(self, start: int, labels: PointLabels) -> None:
        """Write the points from row `start`."""
        if self._rows is not None:
            rows = _lines(self._rows, start, len(labels.codes))
            self._stream.write(join_rows([rows, *map(number_text, labels.columns().values())], " "))
            return
        order, n = self._header.order, len(labels.codes)
        size = self._header.vertex.dtype(order).itemsize
        if not n:
            return
        old = open_content(self._source).records(np.dtype("u1"), self._header.begin + start * size, n * size)
        added = np.dtype([(CLASS, "u1"), (CONFIDENCE, order + "f4"), (OBJECT, order + "u4")])
        new = np.empty(n, dtype=[("old", "u1", (size,)), ("added", added)])
        new["old"] = old.reshape(n, size)
        for name, values in labels.columns().items():
            new["added"][name] = values
        self._stream.write(new.view(np.uint8).data)

    def copy_rest(self) -> None:
        """Copy the elements after the vertices."""
        vertex = self._header.vertex
        if self._rows is not None:
            end = self._rows.end
        else:
            end = self._header.begin + vertex.count * vertex.dtype(self._header.order).itemsize
        file = open_content(self._source)
        while data := file.read(BLOCK, end):
            self._stream.write(data)
            end += len(data)


def _labelled_head(header: PlyHeader) -> bytes:
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


class _KittiSink:
    """Writer of KITTI labels: classes in the lower 16 bits; the instances of the survey are kept."""

    def __init__(self, source: Path, stream: BinaryIO) -> None:
        self._stream = stream
        labels = label_path(source)
        self._old = np.fromfile(labels, dtype="<u4") if labels is not None else None

    def write(self, start: int, labels: PointLabels) -> None:
        """Write the points from row `start`."""
        packed = labels.codes.astype("<u4")
        if self._old is not None:
            packed |= self._old[start : start + len(packed)] & np.uint32(0xFFFF0000)
        self._stream.write(packed.astype("<u4").tobytes())
