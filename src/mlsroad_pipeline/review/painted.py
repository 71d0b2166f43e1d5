"""Points that strokes in force have painted; without pandas, for the page."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Painted(NamedTuple):
    """Points that strokes in force have painted: rows in ascending order, and their class codes."""

    rows: NDArray[np.uint32] = np.empty(0, np.uint32)
    codes: NDArray[np.uint8] = np.empty(0, np.uint8)

    @classmethod
    def of(cls, strokes: Iterable[tuple[NDArray[np.int64], int]]) -> Painted:
        """Return the points of strokes in order, each with the class of its last stroke."""
        parts = [(rows, np.full(len(rows), code)) for rows, code in strokes]
        if not parts:
            return cls()
        rows, codes = (np.concatenate(columns)[::-1] for columns in zip(*parts, strict=True))
        found, last = np.unique(rows, return_index=True)
        return cls(found.astype(np.uint32), codes[last].astype(np.uint8))

    def on(self, rows: NDArray[np.integer], codes: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the codes of rows with the painted ones in their place."""
        if not len(self.rows):
            return codes
        at = np.minimum(np.searchsorted(self.rows, rows), len(self.rows) - 1)
        return np.where(self.rows[at] == rows, self.codes[at], codes)

    def part(self, start: int, stop: int) -> Painted:
        """Return the points of a range of rows, numbered from its start."""
        low, high = np.searchsorted(self.rows, [start, stop])
        return Painted((self.rows[low:high] - start).astype(np.uint32), self.codes[low:high])


NONE = Painted()
