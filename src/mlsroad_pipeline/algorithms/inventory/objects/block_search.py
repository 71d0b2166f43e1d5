"""Search of the cells in the blocks around a block of a coarse grid."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def gather_cells(
    key: int,
    nx: int,
    reach: int,
    keys: NDArray[np.int64],
    starts: NDArray[np.int64],
    order: NDArray[np.int32],
    found: NDArray,
) -> int:
    """Write the cells in blocks at most `reach` rows and columns from a block into `found`; return their number.

    `nx` is the number of blocks in a row of the grid. `keys`, `starts` and `order` are those of `CellGrid`.
    """
    count = 0
    for dy in range(-reach, reach + 1):
        first = np.searchsorted(keys, key + dy * nx - reach)
        last = np.searchsorted(keys, key + dy * nx + reach + 1)
        for i in range(starts[first], min(starts[last], starts[first] + len(found) - count)):
            found[count] = order[i]
            count += 1
    return count
