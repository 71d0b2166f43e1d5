"""Classes in force of points: painted ones, and those of objects of another class; without pandas, for the page."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_NO_OBJECTS = np.full(1, -1, np.int16)


class Painted(NamedTuple):
    """Points that strokes in force have painted: rows in ascending order, and their class codes."""

    rows: NDArray[np.uint32] = np.empty(0, np.uint32)
    codes: NDArray[np.uint8] = np.empty(0, np.uint8)
    of_objects: NDArray[np.int16] = _NO_OBJECTS  # Class that decisions give to each object, by number; -1 without one

    @classmethod
    def of(
        cls, strokes: Iterable[tuple[NDArray[np.int64], int]], of_objects: NDArray[np.int16] = _NO_OBJECTS
    ) -> Painted:
        """Return the points of strokes in order, each with the class of its last stroke."""
        parts = [(rows, np.full(len(rows), code)) for rows, code in strokes]
        if not parts:
            return cls(of_objects=of_objects)
        rows, codes = (np.concatenate(columns)[::-1] for columns in zip(*parts, strict=True))
        found, last = np.unique(rows, return_index=True)
        return cls(found.astype(np.uint32), codes[last].astype(np.uint8), of_objects)

    def on(
        self, rows: NDArray[np.integer], codes: NDArray[np.uint8], objects: NDArray[np.integer]
    ) -> NDArray[np.uint8]:
        """Return the codes in force of rows of some objects: painted ones, those of the object, or the given ones."""
        if len(self.of_objects) > 1:
            given = self.of_objects[np.where(objects < len(self.of_objects), objects, 0)]
            codes = np.where(given >= 0, given, codes).astype(np.uint8)
        if not len(self.rows):
            return codes
        at = np.minimum(np.searchsorted(self.rows, rows), len(self.rows) - 1)
        return np.where(self.rows[at] == rows, self.codes[at], codes)

    def part(self, start: int, stop: int) -> Painted:
        """Return the points of a range of rows, numbered from its start."""
        low, high = np.searchsorted(self.rows, [start, stop])
        return Painted((self.rows[low:high] - start).astype(np.uint32), self.codes[low:high])


NONE = Painted()
