"""One-to-one assignment of places in plan."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree


def assign_one_to_one(
    first: NDArray[np.float64],
    second: NDArray[np.float64],
    reach: float,
    allowed: Callable[[NDArray[np.int64], NDArray[np.int64]], NDArray[np.bool_]] | None = None,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the assignment with the most pairs within reach and, among these, the least sum of distances.

    `allowed` returns which pairs of rows may be assigned; all by default.

    Examples
    --------
    >>> import numpy as np

    An assignment of nearest pairs first would find one pair of these:

    >>> rows = assign_one_to_one(np.array([[0.0, 0], [0.9, 0]]), np.array([[0.4, 0], [-0.5, 0]]), 0.55)
    >>> [part.tolist() for part in rows]
    [[0, 1], [1, 0]]
    """
    pairs: list[tuple[int, int]] = []
    if len(first) and len(second):
        near = cKDTree(first).sparse_distance_matrix(cKDTree(second), reach, output_type="coo_matrix")
        row, column, distance = near.row.astype(np.int64), near.col.astype(np.int64), near.data
        if allowed is not None and len(row):
            kept = allowed(row, column)
            row, column, distance = row[kept], column[kept], distance[kept]
        size = len(first) + len(second)
        links = coo_array((np.ones(len(row)), (row, column + len(first))), shape=(size, size))
        group = connected_components(links, directed=False)[1][row]
        order = np.argsort(group, kind="stable")
        for part in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
            pairs += _assigned(row[part], column[part], distance[part], reach)
    rows = np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]


def _assigned(
    row: NDArray[np.int64], column: NDArray[np.int64], distance: NDArray[np.float64], reach: float
) -> list[tuple[int, int]]:
    """Return the best pairs of a connected group of candidates."""
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415  # 0.07 s, which most commands need not wait

    a, i = np.unique(row, return_inverse=True)
    b, j = np.unique(column, return_inverse=True)
    cost = np.zeros((len(a), len(b)))
    # The reward of a pair exceeds all distances together, so the number of pairs comes first.
    cost[i, j] = distance - (reach + 1.0) * (min(cost.shape) + 1)
    return [(int(a[p]), int(b[q])) for p, q in zip(*linear_sum_assignment(cost), strict=True) if cost[p, q] < 0]
