"""Parser of rows of numbers, whose errors name the line, and writer of such rows."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.plain_text import shortened
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import WriteOptions
from mlsroad_pipeline.formats.files import Content
from mlsroad_pipeline.formats.standard_columns import COORDINATES
from mlsroad_pipeline.formats.tables import scalar_columns

STRIDE = 50_000  # rows between two indexed byte offsets
BLOCK = 1 << 24


@dataclass(frozen=True)
class TextRows:
    """Rows of a text file after its header."""

    path: Path
    text: Content  # bytes, uncompressed
    first_line: int  # line number of the first row, counted from 1
    n_rows: int  # number of rows; blank lines at the end are not counted
    marks: NDArray[np.int64]  # byte offset of every `STRIDE`-th row
    end: int  # byte offset after the last row

    def read(self, start: int, stop: int) -> bytes:
        """Return the text of rows inside the file, with their line ends."""
        if start >= stop:
            return b""
        at = int(self.marks[start // STRIDE])
        last = -(-stop // STRIDE)
        until = int(self.marks[last]) if last < len(self.marks) else self.end
        data = self.text.read(until - at, at)
        skip = start % STRIDE
        keep = stop - start
        ends = np.flatnonzero(np.frombuffer(data, dtype=np.uint8) == ord("\n")) + 1
        begin = int(ends[skip - 1]) if skip else 0
        finish = int(ends[skip + keep - 1]) if skip + keep <= len(ends) else len(data)
        return data[begin:finish]


def index_rows(path: Path, text: Content, begin: int, first_line: int, *, limit: int | None = None) -> TextRows:
    """Count rows from byte offset ``begin`` and index their byte offsets.

    At most ``limit`` rows; None goes to the end of the file, whose trailing blank lines are left out.
    """
    marks, count, at = [begin], 0, begin
    end = text.size if limit is not None else _end_of_text(text, begin)
    while at < end and (limit is None or count < limit):
        data = text.read(min(BLOCK, end - at), at)
        ends = np.flatnonzero(np.frombuffer(data, dtype=np.uint8) == ord("\n")) + at + 1
        if limit is not None and count + len(ends) >= limit:
            ends = ends[: limit - count]
            end = int(ends[-1])
        first = -count % STRIDE or STRIDE
        marks.extend(ends[first - 1 :: STRIDE].tolist())
        count += len(ends)
        at += len(data)
    if (limit is None or count < limit) and end > begin and text.read(1, end - 1) != b"\n":
        count += 1  # the last row has no line end
    return TextRows(path, text, first_line, count, np.array(marks, dtype=np.int64), end)


def _end_of_text(text: Content, begin: int) -> int:
    """Return the byte offset of the end of the last line that is not blank."""
    end = text.size
    while end > begin:
        at = max(begin, end - 4096)
        tail = text.read(end - at, at)
        filled = len(tail.rstrip())
        if filled:
            line_end = tail.find(b"\n", filled)
            return at + (line_end + 1 if line_end >= 0 else len(tail))
        end = at
    return begin


PARSE_BLOCK = 1 << 22
WHITESPACE = "whitespace"
# Blanks that are replaced before parsing; five searches take less time than one replacement by a pattern.
RUNS = (b"  ", b"\t", b"\n ", b" \n", b" \r")
MISSING = ("", "nan", "NaN", "NAN", "null", "NA")
DECIMAL_COMMA = re.compile(r"[+-]?\d+(,\d+)?([eE][+-]?\d+)?")


@dataclass(frozen=True)
class RowForm:
    """Layout of the rows of a text file."""

    width: int
    delimiter: str  # one character, or ``"whitespace"`` for any run of blanks
    decimal: str = "."
    kept: tuple[int, ...] | None = None  # indices of the values that are numbers; None takes all
    quoted: bool = False  # whether values may be in double quotes

    @property
    def places(self) -> tuple[int, ...]:
        """Return the indices of the values that are parsed."""
        return tuple(range(self.width)) if self.kept is None else self.kept


def parse_rows(
    data: bytes, form: RowForm, *, path: Path, first_line: int, threads: bool = False
) -> list[NDArray[np.float64]]:
    """Return the kept columns of whole rows of text; an empty or "nan" value is NaN.

    `ReadError` with file, line and content if a row has another number of values or one is not a number. ``threads``:
    the parser may use all processors.
    """
    if not data:
        return [np.empty(0) for _ in form.places]
    n_rows = data.count(b"\n") + (not data.endswith(b"\n"))
    try:
        columns = _parse(data, form, threads)
    except pa.ArrowInvalid as error:
        if form.delimiter not in (" ", "\t"):
            raise _explained(data, form, path=path, first_line=first_line, reason=str(error)) from error
        blanks = RowForm(form.width, WHITESPACE, form.decimal, form.kept, form.quoted)
        return parse_rows(data, blanks, path=path, first_line=first_line, threads=threads)
    if len(columns[0]) != n_rows:  # the parser skips blank lines
        reason = f"{len(columns[0])} of {n_rows} rows hold numbers"
        raise _explained(data, form, path=path, first_line=first_line, reason=reason)
    return columns


def _parse(data: bytes, form: RowForm, threads: bool) -> list[NDArray[np.float64]]:
    if form.delimiter == WHITESPACE and (data[:1] == b" " or data[-1:] == b" " or any(run in data for run in RUNS)):
        data = re.sub(rb"(?m)^ +| +(?=\r?$)", b"", re.sub(rb"[ \t]+", b" ", data))
    names = [str(i) for i in range(form.width)]
    kept = [names[i] for i in form.places]
    delimiter = " " if form.delimiter == WHITESPACE else form.delimiter
    table = pa.csv.read_csv(
        pa.BufferReader(data),
        read_options=pa.csv.ReadOptions(column_names=names, use_threads=threads, block_size=PARSE_BLOCK),
        parse_options=pa.csv.ParseOptions(delimiter=delimiter, quote_char='"' if form.quoted else False),
        convert_options=pa.csv.ConvertOptions(
            column_types=dict.fromkeys(kept, pa.float64()),
            include_columns=kept,
            null_values=MISSING,
            decimal_point=form.decimal,
        ),
    )
    return [column.to_numpy() for column in table.columns]


def typed_column(values: NDArray[np.float64], dtype: np.dtype, what: str, path: Path) -> NDArray:
    """Return a parsed column in the type that the file header states; floats too large for it become infinite."""
    if dtype.kind == "f":
        with np.errstate(over="ignore"):
            return values.astype(dtype)
    limits = np.iinfo(dtype)
    if len(values) and not limits.min <= values.min() <= values.max() <= limits.max:
        raise ReadError(f"{path}: {what} has values {values.min()} to {values.max()}, outside its type {dtype}")
    return values.astype(dtype)


def split_row(line: str, delimiter: str) -> list[str]:
    """Return the values of one row as text, blanks around them removed."""
    if delimiter in (WHITESPACE, " ", "\t"):
        return line.split()
    return [value.strip() for value in line.strip().split(delimiter)]


def is_number(text: str, decimal: str = ".") -> bool:
    """Return whether a value is one that `parse_rows` accepts: a number, or the mark of a missing one."""
    text = text.strip('"')
    if text in MISSING:
        return True
    if decimal == ",":
        return DECIMAL_COMMA.fullmatch(text) is not None
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def _explained(data: bytes, form: RowForm, *, path: Path, first_line: int, reason: str) -> ReadError:
    places = set(form.places)
    for number, line in enumerate(data.decode("utf-8", "replace").splitlines(), start=first_line):
        values = split_row(line, form.delimiter)
        shown = shortened(line, 100)
        if len(values) != form.width:
            return ReadError(f"{path}, line {number}: {len(values)} values instead of {form.width}: {shown!r}")
        numbers = [value for i, value in enumerate(values) if i in places]
        wrong = next((value for value in numbers if not is_number(value, form.decimal)), None)
        if wrong is not None:
            return ReadError(f"{path}, line {number}: {wrong!r} is not a number: {shown!r}")
    return ReadError(f"{path}, lines from {first_line}: {reason}")


def column_names(cloud: PointCloud, options: WriteOptions) -> bytes:
    """Return the row of names above the points."""
    names = scalar_columns(cloud.select(np.arange(0)), options.metres)
    return (options.delimiter.join(names) + "\n").encode()


def write_columns(cloud: PointCloud, options: WriteOptions) -> bytes:
    """Return points as rows of text."""
    columns = scalar_columns(cloud, options.metres)
    texts = [
        pa.array([f"{value:.{options.decimals}f}" for value in values.tolist()], pa.string())
        if name in COORDINATES
        else number_text(values)
        for name, values in columns.items()
    ]
    return join_rows(texts, options.delimiter)


def number_text(values: NDArray) -> pa.Array:
    """Return numbers as the shortest text that reads back unchanged; "nan" for NaN."""
    native = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("="))
    return pc.cast(pa.array(native.astype(np.uint8) if native.dtype == np.bool_ else native), pa.string())


def join_rows(texts: Sequence[pa.Array], delimiter: str) -> bytes:
    """Join columns of text into rows with line ends."""
    if not len(texts[0]):
        return b""
    rows = pc.binary_join_element_wise(*texts, delimiter)
    joined = pc.binary_join(pa.ListArray.from_arrays(pa.array([0, len(rows)], pa.int32()), rows), "\n")
    return bytes(joined[0].as_buffer()) + b"\n"
