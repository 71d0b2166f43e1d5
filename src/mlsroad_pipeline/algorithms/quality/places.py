"""Separate places of a survey: groups of occupied cells with wide gaps between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

PLACE_CELL = 500.0
"""Side of the cells, metres: points in cells that do not touch lie in different places."""


def count_places(xy: NDArray[np.float64]) -> int:
    """Return the number of places that lie more than `PLACE_CELL` apart.

    Examples
    --------
    >>> count_places(np.array([[0.0, 0.0], [30.0, 0.0], [4000.0, 0.0]]))
    2
    """
    cells = np.unique(np.floor(xy / PLACE_CELL), axis=0)
    if len(cells) < 2:
        return len(cells)
    pairs = cKDTree(cells).query_pairs(1.5, output_type="ndarray")  # neighbours along an axis or a diagonal
    links = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    return int(connected_components(links, directed=False)[0])


def cell_positions(keys: NDArray[np.int64], side: float) -> NDArray[np.float64]:
    """Return the corners of cells from keys with the column in the upper and the row in the lower 32 bits."""
    rows = ((keys + (1 << 31)) & 0xFFFFFFFF) - (1 << 31)
    return np.column_stack([(keys - rows) >> 32, rows]) * side
