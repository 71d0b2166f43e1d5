"""Names of the columns of a text file: in a row above the points, or in a comment."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.column_names import names_coordinates
from mlsroad_pipeline.formats.text.values import is_number, split_row

SEPARATORS = (r"\t", r"\s*;\s*", r"\s*,\s*", r"\s{2,}", r"\s+")
"""Patterns that may separate names, whatever separates the values."""

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
    shown = text if len(text) <= 100 else text[:97] + "..."
    if len(names) != width:
        raise ReadError(f"{path}, line {line}: {len(names)} names for {width} values: {shown!r}; {OPTIONS}")
    if len(set(names)) < len(names):
        raise ReadError(f"{path}, line {line}: a name is duplicated: {', '.join(names)}; rename one, or {OPTIONS}")
    return names
