"""Kerbs of a survey: the steps of each scene, and lines through those of all scenes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_row, line_table
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.ground_cells import ground_cells
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.steps import StepLimits, Steps, find_steps
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.tracing import trace_lines
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import GROUPS, group_shares
from mlsroad_pipeline.algorithms.inventory.objects.table import empty_table
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

STEP_COLUMNS = ("x", "y", "z", "height", "up_x", "up_y", "roughness")
"""Columns of the steps of a scene: place of the foot in world coordinates, height, direction, roughness."""

LEAST_LENGTH = 2.0
"""Shorter lines are left out, metres."""

_BAND = (-0.4, 0.45)  # heights above the ground that hold both sides of a kerb, metres
_GROUND = [GROUPS.index(name) for name in ("paved ground", "natural ground")]


def ground_classes(scheme: ClassScheme) -> NDArray[np.bool_]:
    """Return which classes of a scheme are ground, shape (classes,)."""
    return np.asarray(group_shares(scheme)[:, _GROUND].sum(axis=1) > 0.5)


def no_steps() -> pd.DataFrame:
    """Return a table of steps without rows."""
    return empty_table(dict.fromkeys(STEP_COLUMNS, "float64"))


def kerb_steps(
    xyz: NDArray[np.floating],
    height: NDArray[np.floating],
    labels: NDArray[np.integer],
    *,
    is_ground: NDArray[np.bool_],
    core: NDArray[np.bool_],
    origin: NDArray[np.float64],
    limits: StepLimits | None = None,
) -> pd.DataFrame:
    """Return the steps of the ground in the core of a scene.

    Points of other classes than ground, and points far from the ground, are left out: wheels, hedges and the feet of
    walls are no kerbs.
    """
    near = (height > _BAND[0]) & (height < _BAND[1])  # false where the height is NaN
    near &= np.append(is_ground, True)[labels]
    rows = np.flatnonzero(near)
    if len(rows) == 0:
        return no_steps()
    ground = np.ascontiguousarray(xyz.take(rows, axis=0), dtype=np.float64)
    cells = ground_cells(ground)
    own = core[rows[cells.points.order[cells.points.starts[:-1]]]]  # a cell belongs to the scene of its first point
    steps = find_steps(cells, ground, limits or StepLimits(), wanted=own)
    values = [steps.xyz + origin, steps.height[:, None], steps.upward, steps.roughness[:, None]]
    return pd.DataFrame(np.hstack(values), columns=list(STEP_COLUMNS))


def join_kerbs(
    scenes: Sequence[pd.DataFrame], trajectory: Trajectory | None = None, *, least_length: float = LEAST_LENGTH
) -> pd.DataFrame:
    """Return the kerbs of a pass as lines."""
    filled = [table for table in scenes if len(table)]
    if not filled:
        return line_table([])
    values = np.concatenate([table[list(STEP_COLUMNS)].to_numpy(dtype=np.float64) for table in filled])
    steps = Steps(values[:, :3], values[:, 4:6], values[:, 3], values[:, 6])
    return line_table([_row(line, trajectory) for line in trace_lines(steps, least_length=least_length)])


def _row(line: NDArray[np.float64], trajectory: Trajectory | None) -> dict[str, object]:
    low, median, high = (float(value) for value in np.quantile(line[:, 3], [0.0, 0.5, 1.0]))
    return line_row("kerb", line[:, :3], trajectory, height=median, least_height=low, most_height=high)
