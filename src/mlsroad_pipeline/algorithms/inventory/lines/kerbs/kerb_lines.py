"""Kerbs of a survey: limits and search of the steps of each scene, and lines through those of all scenes."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_row, line_table
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.step_kernels import GroundCells, fit_steps, ground_cells
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import GROUPS, group_shares
from mlsroad_pipeline.algorithms.inventory.objects.table import empty_table
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory


@dataclass(frozen=True)
class StepLimits:
    """Limits of a kerb's step."""

    # Height of the step, metres. A smaller least height finds dropped kerbs and the edges of grass, too.
    least_height: float = 0.05
    most_height: float = 0.3
    # Largest root mean square distance from the two planes, metres. Larger accepts grass and rough edges.
    roughness: float = 0.02
    relative_roughness: float = 0.25  # The same as a share of the height; the larger of both counts
    slope: float = 0.2  # Largest slope of the ground on both sides

    def __post_init__(self) -> None:
        for name in ("least_height", "most_height", "roughness", "relative_roughness", "slope"):
            check_positive(getattr(self, name), name)
        if self.least_height > self.most_height:
            raise ParameterError(f"least_height {self.least_height} is above most_height {self.most_height}")


@dataclass(frozen=True)
class Steps:
    """Steps in the ground, one for each cell on an edge."""

    xyz: NDArray[np.float64]  # Place on the edge and height of the ground at its foot, metres
    upward: NDArray[np.float64]  # Unit vectors in plan across the edge, towards the upper side
    height: NDArray[np.float64]  # Height of the step, metres
    roughness: NDArray[np.float64]  # Root mean square distance from the planes, metres
    # Row of the step's cell in `GroundCells`; empty for steps of several scenes
    cell: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


def find_steps(
    cells: GroundCells, xyz: NDArray[np.floating], limits: StepLimits, *, wanted: NDArray[np.bool_] | None = None
) -> Steps:
    """Return the steps of the ground.

    Around each cell with a difference in height, a plane with a jump along a line is fitted by least squares, twice
    without the cells far from it. The line goes through the cell; of several directions the smallest residual counts.
    """
    blocks, points = cells.blocks, cells.points
    fits = fit_steps(
        cells.xyz,
        *(blocks.order, blocks.keys, blocks.starts, blocks.shape[0], limits.least_height),
        *(points.order, points.starts, np.ascontiguousarray(xyz, dtype=np.float64)),
        np.ones(len(cells.xyz), np.bool_) if wanted is None else wanted,
    )
    height, rough, slope = fits[:, 0], fits[:, 3], np.hypot(fits[:, 5], fits[:, 6])
    kept = (height >= limits.least_height) & (height <= limits.most_height) & (slope <= limits.slope)
    kept &= rough <= np.maximum(limits.roughness, limits.relative_roughness * height)
    rows = np.flatnonzero(kept)
    place = cells.xyz[rows]
    place[:, :2] += fits[rows, 4:5] * fits[rows, 1:3]
    place[:, 2] = fits[rows, 7]
    return Steps(place, fits[rows, 1:3], height[rows], rough[rows], rows)


STRIDES = (0.4, 0.8, 1.2, 1.6, 2.0)
"""Distances at which a line is continued, metres; the last is the largest gap."""

SHORT_LINE, SHORT_STRIDES = 3, 3
"""Lines of fewer vertices in one direction are continued at the first strides alone: their direction is uncertain."""

_REACH, _LATERAL = 0.3, 0.2  # metres around the expected place
_TAKEN = 0.35  # steps this near to a line belong to it, metres


def trace_lines(steps: Steps, *, least_length: float) -> list[NDArray[np.float64]]:
    """Return lines through steps, with the upper side on the left.

    From the clearest step on, a line is continued in both directions to the mean of the steps ahead whose edges run the
    same way.
    """
    if len(steps.height) == 0:
        return []
    tracer = _Tracer(steps)
    lines = [tracer.line(i) for i in np.argsort(-tracer.weight, kind="stable") if tracer.free[i]]
    return [line for line in lines if len(line) > 1 and _length(line) >= least_length]


def _length(line: NDArray[np.float64]) -> float:
    return float(np.hypot(*np.diff(line[:, :2], axis=0).T).sum())


class _Tracer:
    """Steps that are not yet part of a line."""

    def __init__(self, steps: Steps) -> None:
        self.origin = steps.xyz[0, :2].copy()
        self.place = steps.xyz[:, :2] - self.origin
        self.along = np.column_stack([steps.upward[:, 1], -steps.upward[:, 0]])
        self.values = np.column_stack([steps.xyz, steps.height])
        self.weight = steps.height / (steps.roughness + 0.01)
        self.free = np.ones(len(self.place), dtype=bool)
        self.tree = cKDTree(self.place)

    def line(self, start: int) -> NDArray[np.float64]:
        """Return the vertices of the line through a step, and take its steps."""
        self._take(self.place[start], self.along[start])
        first = self._vertex(np.array([start]))
        ahead = self._way(start, 1.0)
        back = self._way(start, -1.0)
        return np.array([*back[::-1], first, *ahead])

    def _vertex(self, rows: NDArray[np.int64]) -> NDArray[np.float64]:
        weight = self.weight[rows, None]
        return np.asarray((self.values[rows] * weight).sum(axis=0) / weight.sum())

    def _take(self, place: NDArray[np.float64], along: NDArray[np.float64]) -> None:
        rows = np.array(self.tree.query_ball_point(place, _TAKEN, return_sorted=True), dtype=np.int64)
        self.free[rows[self.along[rows] @ along > 0.6]] = False

    def _way(self, start: int, sign: float) -> list[NDArray[np.float64]]:
        place, along = self.place[start], sign * self.along[start]
        vertices: list[NDArray[np.float64]] = []
        while True:
            rows = self._ahead(place, along, sign, STRIDES[: SHORT_STRIDES if len(vertices) < SHORT_LINE else None])
            if rows is None:
                return vertices
            vertex = self._vertex(rows)
            moved = vertex[:2] - self.origin - place
            turned = sign * (self.along[rows] * self.weight[rows, None]).sum(axis=0)
            along = 0.4 * moved / np.hypot(*moved) + 0.6 * turned / np.hypot(*turned)
            along /= np.hypot(*along)
            for share in np.linspace(0.0, 1.0, 1 + int(np.ceil(np.hypot(*moved) / _TAKEN)))[1:]:
                self._take(place + share * moved, sign * along)
            place = place + moved
            vertices.append(vertex)

    def _ahead(
        self, place: NDArray[np.float64], along: NDArray[np.float64], sign: float, strides: tuple[float, ...]
    ) -> NDArray[np.int64] | None:
        """Return the steps that continue a line, None at its end."""
        across = np.array([-along[1], along[0]])
        for stride in strides:
            rows = np.array(
                self.tree.query_ball_point(place + stride * along, _REACH, return_sorted=True), dtype=np.int64
            )
            apart = self.place[rows] - place
            fits = self.free[rows] & (sign * self.along[rows] @ along > 0.85) & (apart @ along > 0.1)
            fits &= np.abs(apart @ across) < _LATERAL * max(1.0, stride / 0.8)
            if fits.any():
                return rows[fits]
        return None


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
