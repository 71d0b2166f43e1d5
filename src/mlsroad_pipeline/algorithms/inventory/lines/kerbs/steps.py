"""Steps in the ground: a plane with a jump, fitted around each cell."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.step_kernels import GroundCells, fit_steps


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
