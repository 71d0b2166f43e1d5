"""Index of the rows of text files, plain or gzip-compressed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.formats.content import Content

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
