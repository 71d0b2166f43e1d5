"""Number of points per class after all decisions: those of the tiles, less and more what decisions changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.review.page_server.cloud_files import CloudFiles
from mlsroad_pipeline.review.page_server.selection import Near, points_in_box
from mlsroad_pipeline.review.page_server.tile_format import TileIndex
from mlsroad_pipeline.review.painted import Painted

Box = tuple[NDArray[np.float64], NDArray[np.float64]]

_SLACK = 0.05  # of the box of an object, metres: its points were rounded


class ClassCounts:
    """Counts of the classes in force; what was read once is kept."""

    def __init__(
        self, tiles: TileIndex, counts: Mapping[str, int], clouds: CloudFiles, box_of: Callable[[int], Box]
    ) -> None:
        self._tiles, self._clouds, self._box_of = tiles, clouds, box_of
        self._labelled = np.zeros(256, np.int64)
        for code, count in counts.items():
            self._labelled[int(code)] = count
        self._known: tuple[NDArray[np.uint32], NDArray[np.uint8]] = np.empty(0, np.uint32), np.empty(0, np.uint8)
        self._objects: dict[int, Near] = {}

    def know(self, points: Near) -> None:
        """Keep the classes of points as labelled, which need not be read again."""
        rows, first = np.unique(np.concatenate([self._known[0], points.rows]), return_index=True)
        self._known = rows, np.concatenate([self._known[1], points.labelled])[first]

    def now(self, painted: Painted) -> dict[str, int]:
        """Return the number of points of each class in force, by code."""
        changed = np.flatnonzero(painted.of_objects >= 0).tolist()
        parts = [self._of_object(number) for number in changed]
        rows = np.concatenate([painted.rows, *(part.rows for part in parts)])
        labelled = np.concatenate([self._codes(painted.rows), *(part.labelled for part in parts)])
        objects = np.concatenate([np.zeros(len(painted.rows), np.uint32), *(part.objects for part in parts)])
        rows, first = np.unique(rows, return_index=True)
        labelled, objects = labelled[first], objects[first]
        counts = self._labelled - np.bincount(labelled, minlength=256)
        counts += np.bincount(painted.on(rows, labelled, objects), minlength=256)
        return {str(code): int(counts[code]) for code in np.flatnonzero(counts)}

    def _of_object(self, number: int) -> Near:
        if number not in self._objects:
            low, high = self._box_of(number)
            near = points_in_box(self._tiles, low - _SLACK, high + _SLACK)
            self._objects[number] = near.select(near.objects == number)
        return self._objects[number]

    def _codes(self, rows: NDArray[np.uint32]) -> NDArray[np.uint8]:
        """Return the classes of ascending rows as labelled; those that no stroke of this page selected are read."""
        known, codes = self._known
        missing = np.setdiff1d(rows, known, assume_unique=True)
        if len(missing):
            none = np.zeros(len(missing), np.uint32)
            read = self._clouds.codes(missing)
            self.know(Near(np.empty((len(missing), 3), np.float32), missing, read, read, none))
            known, codes = self._known
        return codes[np.searchsorted(known, rows)]
