"""Barriers of a survey: walls, fences and guard rails as lines through the points of their class."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.geometry.thinning import first_in_cells
from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_row, line_table
from mlsroad_pipeline.algorithms.inventory.lines.markings.stripes import Stripes
from mlsroad_pipeline.algorithms.inventory.lines.markings.tracing import LEAST_START, trace_markings
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import GROUPS, group_shares
from mlsroad_pipeline.algorithms.inventory.objects.table import empty_table
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

CELL_COLUMNS = ("x", "y", "foot", "low", "high", "voxels")
"""Columns of the cells of a scene: mean place, heights of the ground and of the lowest and highest point, voxels."""

LEAST_LENGTH = 3.0
"""Shorter lines are left out, metres."""

_CELL, _VOXEL = 0.2, 0.1  # edges in plan and of the voxels that count once, metres
_AROUND, _FEWEST = 0.8, 4  # metres and cells of which the direction is that of a cell
_THICK, _ASIDE, _LONG = 0.2, 0.26, 0.22  # largest deviation across, of them and of the cell; least along, metres
_LOWEST = -0.2  # height above the ground of a point, metres: below are reflections
_TALL = 0.25  # least height from the low to the high points around, metres
_WIDTH = 0.25  # within which cells are of the same line, metres
_WALL = GROUPS.index("wall")


def barrier_cells(
    xyz: NDArray[np.floating],
    height: NDArray[np.floating],
    labels: NDArray[np.integer],
    *,
    scheme: ClassScheme,
    core: NDArray[np.bool_],
    origin: NDArray[np.float64],
) -> pd.DataFrame:
    """Return the cells in plan of the points of walls and fences in the core of a scene."""
    is_wall = group_shares(scheme)[:, _WALL] > 0.5
    rows = np.flatnonzero(core & np.append(is_wall, False)[labels] & ~(height < _LOWEST))
    if len(rows) == 0:
        return empty_table(dict.fromkeys(CELL_COLUMNS, "float64"))
    rows = rows[first_in_cells(xyz[rows], _VOXEL)]
    x, y, z = xyz[rows].astype(np.float64).T
    place = np.floor(np.column_stack([x, y]) / _CELL)
    _, cell, count = np.unique(place, axis=0, return_inverse=True, return_counts=True)
    cell = cell.ravel()
    low, high = np.full(len(count), np.inf), np.full(len(count), -np.inf)
    np.minimum.at(low, cell, z)
    np.maximum.at(high, cell, z)
    ground = np.where(np.isfinite(height[rows]), z - height[rows], low[cell])
    means = (np.bincount(cell, values) / count for values in (x, y, ground))
    place = np.column_stack([*means, low, high]) + origin[[0, 1, 2, 2, 2]]
    return pd.DataFrame(np.column_stack([place, count]), columns=list(CELL_COLUMNS))


def join_barriers(
    scenes: Sequence[pd.DataFrame], trajectory: Trajectory | None = None, *, least_length: float = LEAST_LENGTH
) -> pd.DataFrame:
    """Return the barriers of a pass as lines along their foot."""
    filled = [table for table in scenes if len(table)]
    if not filled:
        return line_table([])
    cells = np.concatenate([table[list(CELL_COLUMNS)].to_numpy(dtype=np.float64) for table in filled])
    lines = trace_markings(_upright(cells), least_length=least_length)
    return line_table([_row(line, trajectory) for line in lines])


def _upright(cells: NDArray[np.float64]) -> Stripes:
    """Return the cells that lie on a thin upright surface, with its direction."""
    plan, low, high = cells[:, :2] - cells[:, :2].mean(axis=0), cells[:, 3], cells[:, 4]
    lists = cKDTree(plan).query_ball_point(plan, _AROUND, return_sorted=True)
    n = np.array([len(rows) for rows in lists])
    near, starts = np.concatenate([np.asarray(rows, dtype=np.int64) for rows in lists]), np.append(0, np.cumsum(n)[:-1])

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.add.reduceat(values[near], starts) / n)

    x, y = plan.T
    mx, my = mean(x), mean(y)
    xx, yy, xy = mean(x * x) - mx**2, mean(y * y) - my**2, mean(x * y) - mx * my
    half, turn = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    angle = np.arctan2(2 * xy, xx - yy) / 2
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    aside = np.abs((x - mx) * along[:, 1] - (y - my) * along[:, 0])
    ends = [mean(v) + sign * np.sqrt(np.maximum(mean(v * v) - mean(v) ** 2, 0.0)) for v, sign in ((low, -1), (high, 1))]
    fits = (n >= _FEWEST) & (half - turn < _THICK**2) & (half + turn > _LONG**2)
    fits &= (aside < _ASIDE) & (ends[1] - ends[0] > _TALL)
    own = cells[fits]
    width = np.full(len(own), _WIDTH)
    return Stripes(own[:, :3], along[fits], width, LEAST_START + own[:, 5], own[:, 4] - own[:, 2])


def _row(line: NDArray[np.float64], trajectory: Trajectory | None) -> dict[str, object]:
    low, median, high = (float(value) for value in np.quantile(line[:, 4], [0.0, 0.5, 1.0]))
    return line_row("barrier", line[:, :3], trajectory, height=median, least_height=low, most_height=high)
