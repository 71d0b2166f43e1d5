"""Points that a stroke of the brush or a click on a cluster selects, from the tiles at full detail."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.review.page_server.tile_format import TileIndex
from mlsroad_pipeline.review.painted import NONE, Painted

MOST_POINTS = 400_000
"""Largest number of points of one stroke."""
REACH, GAP = 6.0, 0.12
"""Of a cluster: largest distance from the click along an axis, and edge of the cells that must touch, metres."""


class TooManyPointsError(ParameterError):
    """A stroke selects more points than one decision may have."""


class Near(NamedTuple):
    """Points: local coordinates, rows in the survey, class codes in force and as labelled, numbers of objects."""

    xyz: NDArray[np.float32]
    rows: NDArray[np.uint32]
    classes: NDArray[np.uint8]
    labelled: NDArray[np.uint8]
    objects: NDArray[np.uint32]

    def select(self, index: NDArray) -> Near:
        """Return the points of an index."""
        return Near(*(column[index] for column in self))


def points_in_box(
    tiles: TileIndex, low: NDArray[np.float64], high: NDArray[np.float64], painted: Painted = NONE
) -> Near:
    """Return all points of a box with their classes in force."""
    parts = []
    for row in tiles.touching(low, high):
        xyz, chunk = tiles.load(row)
        inside = ((xyz >= low) & (xyz <= high)).all(axis=1)
        codes = chunk.codes[inside, 0]
        parts.append(Near(xyz[inside], chunk.rows[inside], codes, codes, chunk.objects[inside]))
    near = _joined(parts)
    return near._replace(classes=painted.on(near.rows, near.labelled, near.objects))


def _joined(parts: Sequence[Near]) -> Near:
    if parts:
        return Near(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    rows, codes = np.empty(0, np.uint32), np.empty(0, np.uint8)
    return Near(np.empty((0, 3), np.float32), rows, codes, codes, rows)


def brushed(
    tiles: TileIndex,
    centres: NDArray[np.float64],
    radius: float,
    only: int | None = None,
    painted: Painted = NONE,
) -> Near:
    """Return the points within a radius of the centres of a stroke by row; `only` keeps those of one class.

    Raises ParameterError for more than `MOST_POINTS` points.
    """
    found = []
    for centre in centres:
        near = points_in_box(tiles, centre - radius, centre + radius, painted)
        inside = ((near.xyz - centre) ** 2).sum(axis=1) <= radius**2
        found.append(near.select(inside & (True if only is None else near.classes == only)))
    every = _joined(found)
    return _checked(every.select(np.unique(every.rows, return_index=True)[1]))


def cluster(
    tiles: TileIndex,
    place: NDArray[np.float64],
    only: int,
    painted: Painted = NONE,
    *,
    reach: float = REACH,
    gap: float = GAP,
) -> Near:
    """Return the points of one class that are connected with a place, over cells of `gap` metres, by row.

    Raises ParameterError for more than `MOST_POINTS` points.
    """
    from scipy import ndimage  # noqa: PLC0415  # half a second that the first picture does not wait for

    near = points_in_box(tiles, place - reach, place + reach, painted)
    near = near.select(near.classes == only)
    if not len(near.rows):
        return near
    cells = np.floor((near.xyz - (place - reach)) / gap).astype(np.int64)
    n_cells = int(2 * reach / gap) + 1
    occupied = np.zeros((n_cells,) * 3, dtype=np.bool_)
    occupied[tuple(cells.T)] = True
    labels, _ = ndimage.label(occupied, structure=np.ones((3, 3, 3)))
    of_points = labels[tuple(cells.T)]
    seed = of_points[np.argmin(((near.xyz - place) ** 2).sum(axis=1))]
    near = near.select(of_points == seed)
    return _checked(near.select(np.argsort(near.rows)))


def _checked(near: Near) -> Near:
    count = len(near.rows)
    if count > MOST_POINTS:
        raise TooManyPointsError(f"{count:,} points are selected, {MOST_POINTS:,} at most: use a smaller brush")
    return near
