"""Separators, names and numbers in rows of text, from a sample of them."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.plain_text import shortened
from mlsroad_pipeline.formats.column_names import names_coordinates
from mlsroad_pipeline.formats.files import first_bytes
from mlsroad_pipeline.formats.text.values import WHITESPACE, is_number, split_row

# Patterns that may separate names, whatever separates the values.
SEPARATORS = (r"\t", r"\s*;\s*", r"\s*,\s*", r"\s{2,}", r"\s+")
OPTIONS = "set header: false if it is a point, comment to skip it, or columns by index"


def decoded(line: bytes) -> tuple[str, str]:
    """Return a line without its end as text, with the encoding: UTF-8, or Latin-1 where it is not UTF-8."""
    bare = line.removeprefix(b"\xef\xbb\xbf").rstrip(b"\r\n")
    try:
        return bare.decode("utf-8"), "utf-8"
    except UnicodeDecodeError:
        return bare.decode("latin-1"), "latin-1"


def split_names(line: str, width: int, delimiter: str) -> list[str]:
    """Return the names of a row; values may have another delimiter than names.

    As many as values (``width``) where one of the usual separators gives so many, or all but an empty one at the end;
    else those that the delimiter gives.
    """
    own = [value.strip() for value in split_row(line, delimiter)]
    for names in (own, *([name.strip() for name in re.split(p, line.strip(" \r\n"))] for p in SEPARATORS)):
        whole = names[:-1] if len(names) == width + 1 and not names[-1] else names
        if len(whole) == width and not any(name.endswith((",", ";")) for name in whole):
            return whole
    return own


def names_in_comments(lines: Sequence[bytes], comment: str, width: int, delimiter: str) -> tuple[int, tuple[str, ...]]:
    """Return index and names of the last comment that names the columns, as `numpy.savetxt` writes; else -1, ().

    A comment without the names of x, y and z is a sentence.
    """
    for index in range(len(lines) - 1, -1, -1):
        text = decoded(lines[index])[0].strip()
        if not text.startswith(comment):
            continue
        names = [name.strip('"') for name in split_names(text.lstrip(comment + "/ "), width, delimiter)]
        if (
            len(names) == width
            and names_coordinates(names)
            and len(set(names)) == width
            and not any(map(is_number, names))
        ):
            return index, tuple(names)
    return -1, ()


def checked_names(values: Sequence[str], width: int, path: Path, line: int, text: str) -> tuple[str, ...]:
    """Return the names of a row above the points; `ReadError` for another number of names, or a repeated one."""
    names = tuple(value.strip('"') for value in values)
    shown = shortened(text, 100)
    if len(names) != width:
        raise ReadError(f"{path}, line {line}: {len(names)} names for {width} values: {shown!r}; {OPTIONS}")
    if len(set(names)) < len(names):
        raise ReadError(f"{path}, line {line}: a name is duplicated: {', '.join(names)}; rename one, or {OPTIONS}")
    return names


def sniffed(sample: Sequence[str], delimiter: str | None, decimal: str | None) -> tuple[str, str]:
    """Return the delimiter and the decimal mark for which most values are numbers, equally many in each row.

    Those that are given are kept; the first row of the sample may hold names.
    """
    row = sample[-1 if len(sample) < 3 else 1]
    blanks = WHITESPACE if "  " in row or row != row.strip() else " "
    delimiters = [delimiter] if delimiter else [*(d for d in (";", ",", "\t") if d in row), blanks]
    marks = [decimal] if decimal else [".", ","]
    candidates = [(d, m) for d in delimiters for m in marks if d != m]
    for rows in (sample, sample[1:]):  # the first row may be names
        shares = [numeric_share(rows, *candidate) for candidate in candidates]
        if rows and (max(shares) == 1.0 or (rows is not sample and max(shares) > 0)):
            return candidates[int(np.argmax(shares))]  # of several the first: sorted by reliability
    return candidates[0]


def numeric_share(rows: Sequence[str], delimiter: str, decimal: str) -> float:
    """Return the share of numbers among the values of rows.

    It is 0 where rows differ in length or have fewer than three columns of numbers.
    """
    values = [split_row(line, delimiter) for line in rows]
    width = len(values[0]) if values else 0
    if width < 3 or any(len(found) != width for found in values):
        return 0.0
    good = np.array([[is_number(value, decimal) for value in found] for found in values]).mean(axis=0)
    return float(good.mean()) if (good >= 0.5).sum() >= 3 else 0.0


def numeric_columns(body: Sequence[str], delimiter: str, decimal: str, width: int) -> tuple[int, ...] | None:
    """Return the indices of columns with a number in some row of the sample; None if all have."""
    rows = [found for found in (split_row(line, delimiter) for line in body) if len(found) == width]
    kept = tuple(i for i in range(width) if any(is_number(found[i], decimal) for found in rows) or not rows)
    return None if len(kept) == width else kept


LAST_LINES = 20  # number of lines among which `holds_rows` searches a row of numbers


def _first_lines(path: Path) -> list[bytes]:
    """Return the whole lines of the first 64 KiB of a file that are not blank."""
    data = first_bytes(path, 1 << 16)
    return [line for line in data.splitlines()[: None if len(data) < 1 << 16 else -1] if line.strip()]


def _is_row(line: bytes) -> bool:
    row = [decoded(line)[0]]
    return numeric_share(row, *sniffed(row, None, None)) > 0.5


def looks_like_table(path: Path) -> bool:
    """Return whether the first 64 KiB of a file are text that ends with a row of at least three numbers."""
    lines = _first_lines(path)
    return bool(lines) and b"\0" not in first_bytes(path, 1 << 16) and _is_row(lines[-1])


def holds_rows(path: Path) -> bool:
    """Return whether one of the last lines of the first 64 KiB of a file is a row of at least three numbers."""
    return any(map(_is_row, _first_lines(path)[-LAST_LINES:]))
