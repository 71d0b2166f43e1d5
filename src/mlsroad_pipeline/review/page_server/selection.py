"""Points that a stroke of the brush or a click on a cluster selects, from the tiles at full detail."""

from __future__ import annotations

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
    """Points of a box: local coordinates, rows in the survey and class codes."""

    xyz: NDArray[np.float32]
    rows: NDArray[np.uint32]
    classes: NDArray[np.uint8]


def points_in_box(
    tiles: TileIndex, low: NDArray[np.float64], high: NDArray[np.float64], painted: Painted = NONE
) -> Near:
    """Return all points of a box with their classes in force."""
    parts = []
    for row in tiles.touching(low, high):
        xyz, chunk = tiles.load(row)
        inside = ((xyz >= low) & (xyz <= high)).all(axis=1)
        parts.append(Near(xyz[inside], chunk.rows[inside], chunk.codes[inside, 0]))
    if not parts:
        return Near(np.empty((0, 3), np.float32), np.empty(0, np.uint32), np.empty(0, np.uint8))
    near = Near(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    return near._replace(classes=painted.on(near.rows, near.classes))


def brushed(
    tiles: TileIndex,
    centres: NDArray[np.float64],
    radius: float,
    only: int | None = None,
    painted: Painted = NONE,
) -> NDArray[np.uint32]:
    """Return the rows of the points within a radius of the centres of a stroke; `only` keeps those of one class.

    Raises ParameterError for more than `MOST_POINTS` points.
    """
    found = []
    for centre in centres:
        near = points_in_box(tiles, centre - radius, centre + radius, painted)
        inside = ((near.xyz - centre) ** 2).sum(axis=1) <= radius**2
        found.append(near.rows[inside & (True if only is None else near.classes == only)])
    return _checked(np.unique(np.concatenate(found)) if found else np.empty(0, np.uint32))


def cluster(
    tiles: TileIndex,
    place: NDArray[np.float64],
    only: int,
    painted: Painted = NONE,
    *,
    reach: float = REACH,
    gap: float = GAP,
) -> NDArray[np.uint32]:
    """Return the rows of the points of one class that are connected with a place, over cells of `gap` metres.

    Raises ParameterError for more than `MOST_POINTS` points.
    """
    from scipy import ndimage  # noqa: PLC0415  # half a second that the first picture does not wait for

    near = points_in_box(tiles, place - reach, place + reach, painted)
    near = Near(*(column[near.classes == only] for column in near))
    if not len(near.rows):
        return near.rows
    cells = np.floor((near.xyz - (place - reach)) / gap).astype(np.int64)
    n_cells = int(2 * reach / gap) + 1
    occupied = np.zeros((n_cells,) * 3, dtype=np.bool_)
    occupied[tuple(cells.T)] = True
    labels, _ = ndimage.label(occupied, structure=np.ones((3, 3, 3)))
    of_points = labels[tuple(cells.T)]
    seed = of_points[np.argmin(((near.xyz - place) ** 2).sum(axis=1))]
    return _checked(np.sort(near.rows[of_points == seed]))


def _checked(rows: NDArray[np.uint32]) -> NDArray[np.uint32]:
    if len(rows) > MOST_POINTS:
        raise TooManyPointsError(f"{len(rows):,} points are selected, {MOST_POINTS:,} at most: use a smaller brush")
    return rows
