"""Layout of a text file from its first rows: comments, names, delimiter, decimal mark, numeric columns."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.content import first_bytes, open_content, unpacked_name
from mlsroad_pipeline.formats.files import FileKey, file_key
from mlsroad_pipeline.formats.text.rows import TextRows, index_rows
from mlsroad_pipeline.formats.text.values import WHITESPACE, RowForm, is_number, parse_rows, split_row

LAYOUTS = {".xyz_label_conf": ("x", "y", "z", "label", "confidence")}
"""Columns of files without a row of names, by file extension (Oakland 3-D)."""

COUNTED = (".pts",)
"""Extensions of files whose first line is the number of points (Leica)."""

HEAD = 1 << 20
SAMPLE = 20

logger = logging.getLogger(__name__)

LAST_LINES = 20
"""Number of lines among which `holds_rows` searches a row of numbers."""


@dataclass(frozen=True)
class TextTable:
    """Rows of a text file and their layout.

    Parameters
    ----------
    rows : TextRows
        Byte offsets of the rows.
    names : tuple of str
        Names of the columns: of the file, else of `LAYOUTS` or x, y, z, column_3, ...
    form : RowForm
        Layout of a row.
    head : bytes
        The lines before the first row: comments, and the names if there are any.
    has_names : bool
        Whether the file has a row of names.
    guess : mapping of str to Any
        Detected mapping of unnamed columns, as in `ReadOptions.columns`; used where that is not set.
    """

    rows: TextRows
    names: tuple[str, ...]
    form: RowForm
    head: bytes
    has_names: bool
    guess: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def delimiter(self) -> str:
        """Return the delimiter."""
        return self.form.delimiter

    @property
    def numeric_names(self) -> tuple[str, ...]:
        """Return the names of the columns that hold numbers."""
        return tuple(self.names[i] for i in self.form.places)


def open_table(path: Path, options: ReadOptions) -> TextTable:
    """Detect and log a text file's delimiter, decimal mark, names and rows.

    Parameters
    ----------
    path : Path
        The file.
    options : ReadOptions
        Its `delimiter`, `decimal`, `header` and `comment`.

    Returns
    -------
    TextTable
        The table; cached as long as the file does not change.

    Raises
    ------
    ReadError
        If there is no row.
    """
    return _open_table(file_key(path), options.delimiter, options.decimal, options.header, options.comment)


@lru_cache(maxsize=4)
def _open_table(
    key: FileKey, delimiter: str | None, decimal: str | None, header: bool | None, comment: str
) -> TextTable:
    path = Path(key[0])
    text = open_content(path)
    lines = text.read(HEAD).splitlines(keepends=True)
    n_head = next((i for i, line in enumerate(lines) if line.strip() and not _is_comment(line, comment)), len(lines))
    if n_head < len(lines) - 1 and _is_count(lines[n_head : n_head + 2], path):
        n_head += 1
    if n_head == len(lines):
        raise ReadError(f"{path} has no rows of points")
    sample = [_decoded(line) for line in lines[n_head : n_head + SAMPLE] if line.strip()]
    found, mark = _sniffed(sample, delimiter, decimal)
    first = split_row(sample[0].lstrip("/"), found)
    numbers = [is_number(value, mark) for value in first]
    has_names = header if header is not None else not all(numbers)
    if header is None and has_names and any(numbers):
        raise ReadError(f"{path}, line {n_head + 1}: neither numbers nor names: {sample[0]!r}")
    if has_names and n_head + 1 == len(lines):
        raise ReadError(f"{path} has no rows of points")
    row_line = n_head + int(has_names)
    begin = sum(len(line) for line in lines[:row_line])
    if n_head == 0 and not has_names and lines[0].startswith(b"\xef\xbb\xbf"):
        begin = 3
    body = sample[int(has_names and len(sample) > 1) :]
    width = len(split_row(body[0], found))
    names = _names(first, width, path, n_head + 1) if has_names else _default_names(path, width)
    kept = _numeric(body, found, mark, width) if has_names else None
    form = RowForm(width, found, mark, kept, any('"' in row for row in body))
    rows = index_rows(path, text, begin, row_line + 1)
    guess = {} if has_names or path_layout(path, width) else _guessed(rows, form)
    table = TextTable(rows, names, form, b"".join(lines[:row_line]), has_names, guess)
    _log(table, path)
    return table


def looks_like_table(path: Path) -> bool:
    """Return whether a file of unknown extension holds rows of at least three numbers.

    Parameters
    ----------
    path : Path
        An existing file.

    Returns
    -------
    bool
        Whether the last whole line of its first 64 KiB is such a row, and all of that is text.
    """
    data = first_bytes(path, 1 << 16)
    lines = [line for line in data.splitlines()[: None if len(data) < 1 << 16 else -1] if line.strip()]
    if b"\0" in data or not lines:
        return False
    row = [_decoded(lines[-1])]
    return _numeric_share(row, *_sniffed(row, None, None)) > 0.5


def holds_rows(path: Path) -> bool:
    """Return whether a text file holds a row of at least three numbers.

    Parameters
    ----------
    path : Path
        An existing file.

    Returns
    -------
    bool
        Whether one of the last lines of its first 64 KiB is such a row.
    """
    data = first_bytes(path, 1 << 16)
    lines = [_decoded(line) for line in data.splitlines()[: None if len(data) < 1 << 16 else -1] if line.strip()]
    return any(_numeric_share([line], *_sniffed([line], None, None)) > 0.5 for line in lines[-LAST_LINES:])


def _log(table: TextTable, path: Path) -> None:
    between = {" ": "blanks", WHITESPACE: "blanks", "\t": "tabs"}.get(table.delimiter, repr(table.delimiter))
    words = [f"{table.rows.n_rows} rows, {between} between values"]
    words += ["decimal comma"] * (table.form.decimal == ",")
    words.append(f"{'named' if table.has_names else 'unnamed'} columns {', '.join(table.names)}")
    skipped = [name for name in table.names if name not in table.numeric_names]
    words += [f"{', '.join(skipped)} left out, for they hold no numbers"] * bool(skipped)
    words += [f"read as {name}: {place}" for name, place in table.guess.items()]
    logger.info("%s: %s", path, "; ".join(words))


def _decoded(line: bytes) -> str:
    return line.decode("utf-8-sig", "replace").rstrip("\r\n")


def _is_comment(line: bytes, comment: str) -> bool:
    return line.lstrip(b"\xef\xbb\xbf \t").startswith(comment.encode())


def _is_count(lines: Sequence[bytes], path: Path) -> bool:
    name = unpacked_name(path).lower()
    return name.endswith(COUNTED) and lines[0].strip().isdigit() and len(lines[1].split()) > 1


def _sniffed(sample: Sequence[str], delimiter: str | None, decimal: str | None) -> tuple[str, str]:
    """Return the delimiter and the decimal mark for which most values are numbers, equally many in each row."""
    row = sample[-1 if len(sample) < 3 else 1]
    blanks = WHITESPACE if "  " in row or row != row.strip() else " "
    delimiters = [delimiter] if delimiter else [*(d for d in (";", ",", "\t") if d in row), blanks]
    marks = [decimal] if decimal else [".", ","]
    candidates = [(d, m) for d in delimiters for m in marks if d != m]
    for rows in (sample, sample[1:]):  # the first row may be names
        shares = [_numeric_share(rows, *candidate) for candidate in candidates]
        if rows and (max(shares) == 1.0 or (rows is not sample and max(shares) > 0)):
            return candidates[int(np.argmax(shares))]  # of several the first: sorted by reliability
    return candidates[0]


def _numeric_share(rows: Sequence[str], delimiter: str, decimal: str) -> float:
    values = [split_row(line, delimiter) for line in rows]
    width = len(values[0]) if values else 0
    if width < 3 or any(len(found) != width for found in values):
        return 0.0
    good = np.array([[is_number(value, decimal) for value in found] for found in values]).mean(axis=0)
    return float(good.mean()) if (good >= 0.5).sum() >= 3 else 0.0


def _numeric(body: Sequence[str], delimiter: str, decimal: str, width: int) -> tuple[int, ...] | None:
    """Return the indices of columns with a number in some row of the sample; None if all have."""
    rows = [found for found in (split_row(line, delimiter) for line in body) if len(found) == width]
    kept = tuple(i for i in range(width) if any(is_number(found[i], decimal) for found in rows) or not rows)
    return None if len(kept) == width else kept


def _names(values: Sequence[str], width: int, path: Path, line: int) -> tuple[str, ...]:
    names = tuple(value.strip('"') for value in values)
    if len(names) != width:
        raise ReadError(f"{path}, line {line}: {len(names)} names for {width} values")
    if len(set(names)) < len(names):
        raise ReadError(f"{path}, line {line}: a name is duplicated: {', '.join(names)}")
    return names


def path_layout(path: Path, width: int) -> tuple[str, ...]:
    """Return the columns of a file by its extension.

    Parameters
    ----------
    path : Path
        The file.
    width : int
        Its values per row.

    Returns
    -------
    tuple of str
        Their names; empty for other extensions.
    """
    name = unpacked_name(path).lower()
    return next((layout for e, layout in LAYOUTS.items() if name.endswith(e) and len(layout) == width), ())


def _default_names(path: Path, width: int) -> tuple[str, ...]:
    known = path_layout(path, width)
    if known:
        return known
    if width < 3:
        raise ReadError(f"{path} has {width} values a row; at least x, y and z are needed")
    return ("x", "y", "z", *(f"column_{i}" for i in range(3, width)))


def _guessed(rows: TextRows, form: RowForm) -> dict[str, Any]:
    """Detect colours in unnamed columns: three whole numbers up to 255 right after x, y, z or after one more column.

    That one is the intensity where it is not negative. Other unnamed columns are not interpreted.
    """
    if form.width < 6:
        return {}
    starts = sorted({0, rows.n_rows // 2, max(rows.n_rows - SAMPLE, 0)})
    parts = []
    for start in starts:
        data = rows.read(start, min(start + SAMPLE, rows.n_rows))
        try:
            parts.append(parse_rows(data, form, path=rows.path, first_line=rows.first_line + start))
        except ReadError:
            return {}  # reading reports the row
    columns = [np.concatenate(values) for values in zip(*parts, strict=True)]
    for first in (3, 4):
        triple = columns[first : first + 3]
        if len(triple) == 3 and all(_is_byte(values) for values in triple) and max(v.max() for v in triple) > 1:
            guess: dict[str, Any] = {"rgb": [first, first + 1, first + 2]}
            if first == 4 and columns[3].min() >= 0:
                guess["intensity"] = 3
            return guess
    return {}


def _is_byte(values: np.ndarray) -> bool:
    with np.errstate(invalid="ignore"):
        return bool(((values >= 0) & (values <= 255) & (values == np.floor(values))).all())
