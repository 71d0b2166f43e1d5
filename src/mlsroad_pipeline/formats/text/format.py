"""Text: one point per row, with or without header comments and a row of names, plain or gzip-compressed.

The first rows decide on comments, names, delimiter, decimal mark and numeric columns.
"""

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.plain_text import shortened
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.crs import write_sidecar
from mlsroad_pipeline.formats.files import FileKey, file_key, open_content, output_file, unpacked_name, with_packed
from mlsroad_pipeline.formats.tables import PointTable, TableFormat, parts_of
from mlsroad_pipeline.formats.text.sniffing import (
    OPTIONS,
    checked_names,
    decoded,
    names_in_comments,
    numeric_columns,
    sniffed,
    split_names,
)
from mlsroad_pipeline.formats.text.values import (
    WHITESPACE,
    RowForm,
    TextRows,
    column_names,
    index_rows,
    is_number,
    parse_rows,
    split_row,
    write_columns,
)

logger = logging.getLogger(__name__)

SAMPLE = 20  # rows of a sample; there is one at the start, in the middle and at the end of a file
LEAST_ROWS = 30  # smallest number of sampled rows of which the first column may be their number
# Least values of eastings, northings and times, and least ratio of times to local coordinates.
FAR, FACTOR = 10_000.0, 10.0
GROWS = "its first column is read as x, but grows from row to row as times do; if it is no x, set columns by index"

COUNTS = (
    "{}, line {}: its first column, {:g}, counts the rows and is no x; set columns by index, such as "
    "{{x: 1, y: 2, z: 3}}"
)


def interpret(rows: TextRows, form: RowForm) -> tuple[dict[str, Any], tuple[str, ...], str]:
    """Return a mapping of unnamed columns behind x, y and z, sentences for the user, and the message of an error.

    Colours are three whole numbers up to 255 right after x, y, z or after one more column, which is the intensity where
    it is not negative. The message is not empty where the first of more than three columns is the number of the row.
    """
    if form.width < 4:
        return {}, (), ""
    index, columns = _sampled(rows, form)
    if not columns:
        return {}, (), ""  # reading reports the row
    # whole numbers before three columns that vary, x, y and z
    whole = columns[0][0] == np.floor(columns[0][0]) and np.ptp(columns[0] - index) == 0
    if len(index) >= LEAST_ROWS and whole and all(np.ptp(values) > 0 for values in columns[1:4]):
        return {}, (), COUNTS.format(rows.path, rows.first_line, columns[0][0])
    steps, apart = np.diff(columns[0]), np.diff(index)
    inside = steps[apart == 1]
    grows = len(inside) and (steps >= 0).all() and 2 * np.count_nonzero(inside > 0) > len(inside)
    return _colours(columns), (GROWS,) * bool(grows and _are_times(columns)), ""


def _are_times(columns: list[NDArray[np.float64]]) -> bool:
    """Return whether a growing first column holds times, and not the x of sorted points.

    Two columns of eastings and northings follow it, or its values are those of seconds of a week, or larger, and far
    above the coordinates that follow.
    """
    time, *others = (float(np.median(np.abs(values))) for values in columns[:3])
    return min(others) >= FAR or (time >= FAR and time >= FACTOR * max(others))


def _sampled(rows: TextRows, form: RowForm) -> tuple[NDArray[np.int64], list[NDArray[np.float64]]]:
    starts = sorted({0, rows.n_rows // 2, max(rows.n_rows - SAMPLE, 0)})
    stops = [min(start + SAMPLE, rows.n_rows) for start in starts]
    try:
        parts = [
            parse_rows(rows.read(start, stop), form, path=rows.path, first_line=rows.first_line + start)
            for start, stop in zip(starts, stops, strict=True)
        ]
    except ReadError:
        return np.empty(0, np.int64), []
    index, once = np.unique(
        np.concatenate([np.arange(start, stop) for start, stop in zip(starts, stops, strict=True)]), return_index=True
    )
    return index, [np.concatenate(values)[once] for values in zip(*parts, strict=True)]


def _colours(columns: list[NDArray[np.float64]]) -> dict[str, Any]:
    for first in (3, 4):
        triple = columns[first : first + 3]
        if len(triple) == 3 and all(_is_byte(values) for values in triple) and max(v.max() for v in triple) > 1:
            guess: dict[str, Any] = {"rgb": [first, first + 1, first + 2]}
            if first == 4 and columns[3].min() >= 0:
                guess["intensity"] = 3
            return guess
    return {}


def _is_byte(values: NDArray[np.float64]) -> bool:
    with np.errstate(invalid="ignore"):
        return bool(((values >= 0) & (values <= 255) & (values == np.floor(values))).all())


# Columns of files without a row of names, by file extension (Oakland 3-D).
LAYOUTS = {".xyz_label_conf": ("x", "y", "z", "label", "confidence")}
BOM = b"\xef\xbb\xbf"  # mark of UTF-8 at the start of a file
HEAD = 1 << 20


@dataclass(frozen=True)
class TextTable:
    """Rows of a text file and their layout."""

    rows: TextRows  # byte offsets of the rows
    names: tuple[str, ...]  # names of the columns: of the file, else of `LAYOUTS` or x, y, z, column_3, ...
    form: RowForm
    head: tuple[bytes, ...]  # lines before the first row: comments, names and the number of points, with their ends
    names_at: int  # index of the line with the names in the head, -1 without names
    guess: Mapping[str, Any] = field(default_factory=dict)  # `ReadOptions.columns` of unnamed columns, where not set
    notes: tuple[str, ...] = ()
    wrong: str = ""  # message of an error unless `ReadOptions.columns` names the coordinates; else empty

    @property
    def numeric_names(self) -> tuple[str, ...]:
        """Return the names of the columns that hold numbers."""
        return tuple(self.names[i] for i in self.form.places)


def open_table(path: Path, options: ReadOptions) -> TextTable:
    """Detect and log a text file's delimiter, decimal mark, names and rows; cached while it does not change."""
    return _open_table(file_key(path), options.delimiter, options.decimal, options.header, options.comment)


@lru_cache(maxsize=4)
def _open_table(
    key: FileKey, delimiter: str | None, decimal: str | None, header: bool | None, comment: str
) -> TextTable:
    path = Path(key[0])
    text = open_content(path)
    lines = _lines(text.read(HEAD), path)
    start = _find_start(lines, path, delimiter, decimal, header, comment)
    body = _sample(lines, start.row_line, path)
    width = len(split_row(body[0], start.delimiter))
    blank = _trailing(body, width, start)
    at, names = start.names_line, tuple[str, ...]()
    if start.names is not None:
        values = split_names(start.names.lstrip("/"), width - blank, start.delimiter)
        names = checked_names(values, width - blank, path, start.names_line + 1, start.names)
    elif header is None and not path_layout(path, width):
        at, names = names_in_comments(lines[: start.n_comments], comment, width - blank, start.delimiter)
    named = bool(names)
    place = f"line {start.row_line + 1}: {shortened(body[0])!r}"
    names = (names or _default_names(path, width - blank, place)) + ("",) * blank
    kept = numeric_columns(body, start.delimiter, start.decimal, width) if named else None
    if "" in names:  # rows that end with a delimiter
        kept = tuple(i for i in (range(width) if kept is None else kept) if names[i])
    form = RowForm(width, start.delimiter, start.decimal, kept, any('"' in row for row in body))
    rows = index_rows(path, text, start.byte, start.row_line + 1)
    guess, notes, wrong = ({}, (), "") if named or path_layout(path, width) else interpret(rows, form)
    if start.stated not in (-1, rows.n_rows):
        notes = (*notes, f"it states {start.stated} points and holds {rows.n_rows}: all are read")
    table = TextTable(rows, names, form, tuple(lines[: start.row_line]), at if named else -1, guess, notes, wrong)
    _log(table, path)
    return table


class _Start(NamedTuple):
    """Place of the first row of points, what precedes it, and how values are separated."""

    n_comments: int
    names_line: int  # that of the row of names; without one, that of the first row of points
    row_line: int
    byte: int  # of the first row of points
    names: str | None  # the row of names
    stated: int  # number of points that the file states, -1 without one
    delimiter: str
    decimal: str


def _find_start(
    lines: Sequence[bytes], path: Path, delimiter: str | None, decimal: str | None, header: bool | None, comment: str
) -> _Start:
    n_comments = next(
        (i for i, line in enumerate(lines) if line.strip() and not _is_comment(line, comment)), len(lines)
    )
    names_line, stated = _skip_count(lines, n_comments)
    sample = _sample(lines, names_line, path)
    sample = [row for i, row in enumerate(sample) if i != 1 or len(sample) == 2 or not row.strip().isdigit()]
    found, mark = sniffed(sample, delimiter, decimal)
    has_names = header if header is not None else _is_names(sample[0], found, mark, path, names_line + 1)
    row_line = names_line + int(has_names)
    if has_names:
        row_line, stated = max((row_line, stated), _skip_count(lines, row_line))
    byte = sum(len(line) for line in lines[:row_line])
    if row_line == 0 and lines[0].startswith(BOM):
        byte = len(BOM)
    return _Start(n_comments, names_line, row_line, byte, sample[0] if has_names else None, stated, found, mark)


def _sample(lines: Sequence[bytes], start: int, path: Path) -> list[str]:
    """Return the first rows from a line on, without empty lines; ReadError if there is none."""
    rows = (line for line in lines[start:] if line.strip())
    found = [decoded(line)[0] for line in islice(rows, SAMPLE)]
    if not found:
        raise ReadError(f"{path} has no rows of points")
    return found


def _trailing(body: Sequence[str], width: int, start: _Start) -> int:
    """Return 1 if rows end with a delimiter, else 0; an empty last column that has a name is no trailing delimiter."""
    if not (width > 3 and start.delimiter in ",;" and all(row.rstrip().endswith(start.delimiter) for row in body)):
        return 0
    if start.names is None:
        return 1
    every = split_names(start.names.lstrip("/"), width, start.delimiter)
    return int(not (len(every) == width and every[-1].strip()))


def _lines(data: bytes, path: Path) -> list[bytes]:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise ReadError(f"{path} is text in UTF-16; save it as UTF-8")
    if b"\r" in data and b"\n" not in data:
        raise ReadError(f"{path}: its lines end with carriage returns alone; save it with line feeds")
    return data.splitlines(keepends=True)


def _skip_count(lines: Sequence[bytes], at: int) -> tuple[int, int]:
    """Return the index after a line with the number of points, and the number, -1 without one."""
    if at >= len(lines) - 1 or not lines[at].strip().isdigit() or len(re.split(rb"[\s,;]+", lines[at + 1].strip())) < 3:
        return at, -1
    return at + 1, int(lines[at])


def _is_names(line: str, delimiter: str, decimal: str, path: Path, number: int) -> bool:
    """Return whether a row holds names; one of numbers and words is neither names nor a point."""
    numbers = [is_number(value, decimal) for value in split_row(line.lstrip("/"), delimiter) if value]
    if all(numbers):
        return False
    tabbed = [is_number(value, decimal) for value in line.lstrip("/").split("\t")]
    if any(numbers) and (len(tabbed) == 1 or any(tabbed)):
        raise ReadError(f"{path}, line {number}: neither numbers nor names: {line!r}; {OPTIONS}")
    return True


def _log(table: TextTable, path: Path) -> None:
    between = {" ": "blanks", WHITESPACE: "blanks", "\t": "tabs"}.get(table.form.delimiter, repr(table.form.delimiter))
    words = [f"{table.rows.n_rows} rows, {between} between values"]
    words += ["decimal comma"] * (table.form.decimal == ",")
    words.append(f"{'unnamed' if table.names_at < 0 else 'named'} columns {', '.join(table.names)}")
    skipped = [name for name in table.names if name not in table.numeric_names]
    words += [f"{', '.join(skipped)} left out, for they hold no numbers"] * bool(skipped)
    words += [f"read as {name}: {place}" for name, place in table.guess.items()]
    logger.info("%s: %s", path, "; ".join(words))


def _is_comment(line: bytes, comment: str) -> bool:
    return line.lstrip(b"\xef\xbb\xbf \t").startswith(comment.encode())


def path_layout(path: Path, width: int) -> tuple[str, ...]:
    """Return the names of the columns of a file by its extension and values per row; empty for other extensions."""
    name = unpacked_name(path).lower()
    return next((layout for e, layout in LAYOUTS.items() if name.endswith(e) and len(layout) == width), ())


def _default_names(path: Path, width: int, row: str) -> tuple[str, ...]:
    known = path_layout(path, width)
    if known:
        return known
    if width < 3:
        raise ReadError(f"{path}, {row} has {width} values; at least x, y and z are needed; set delimiter, or comment")
    return ("x", "y", "z", *(f"column_{i}" for i in range(3, width)))


class TextFormat(TableFormat):
    """Reader and writer of text tables.

    Without a row of names the columns are x, y, z, column_3, column_4 and so on, from 0; colours are detected
    by their values (`text_layout`). Columns of words are left out. All values are float64, but `label` and `instance`
    int32, `rgb` uint8 and `intensity` float32.
    """

    name = "text"
    extensions: tuple[str, ...] = with_packed(".txt", ".xyz", ".csv", ".asc", ".pts", ".xyz_label_conf")
    signatures: tuple[bytes, ...] = ()

    def open_table(self, path: Path, options: ReadOptions) -> PointTable:
        """Open a file; its rows are counted, not parsed."""
        found = open_table(path, options)
        placed = "x" in options.columns
        if found.wrong and not placed:
            raise ReadError(found.wrong)

        def rows(names: Sequence[str], start: int, stop: int) -> Mapping[str, NDArray]:
            data, line = found.rows.read(start, stop), found.rows.first_line + start
            parsed = parse_rows(data, found.form, path=path, first_line=line, threads=options.n_threads > 1)
            columns = dict(zip(found.numeric_names, parsed, strict=True))
            return {name: columns[name] for name in names}

        notes = tuple(note for note in found.notes if not (placed and note == GROWS))
        details = {"delimiter": found.form.delimiter, "decimal": found.form.decimal, "names": found.names}
        return PointTable(found.numeric_names, found.rows.n_rows, rows, None, details, notes, found.guess)

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write a cloud as text with a row of names, compressed where the path ends in ``.gz``.

        Floats other than coordinates are written with as many digits as it takes to read them back unchanged.
        """
        path = Path(path)
        with output_file(path) as stream:
            stream.write(column_names(cloud, options))
            for part in parts_of(cloud):
                stream.write(write_columns(part, options))
        write_sidecar(path, cloud.crs)
