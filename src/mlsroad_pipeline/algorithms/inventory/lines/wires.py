"""Overhead wires: parabolas in upright planes through the points of wires."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_row, line_table
from mlsroad_pipeline.algorithms.inventory.lines.wire_curves import Wire, Wires
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import GROUPS, ClassEvidence
from mlsroad_pipeline.algorithms.inventory.objects.table import empty_table
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

LIKELY = 0.15
"""Least probability of a point of a wire."""

LEAST_SCORE = 0.5
"""Wires whose points have a lower mean probability are left out."""

CELL = 0.1
"""Points of wires are thinned to one per cube of this edge, metres."""

WIRE_COLUMNS = ("x", "y", "z", "height", "probability")
"""Columns of the thinned points of wires: world coordinates, height above the ground (metres), probability."""

_SPACING = 1.0  # of the vertices, metres


def wire_probability(evidence: ClassEvidence) -> NDArray[np.float32]:
    """Return the probability of each point of a scene to be a wire, shape (n,); 0 for points without a class."""
    return np.append(evidence.of_groups[:, GROUPS.index("wire")], np.float32(0.0))[evidence.owner]


def no_wire_points() -> pd.DataFrame:
    """Return a table of points of wires without rows."""
    return empty_table(dict.fromkeys(WIRE_COLUMNS, "float64"))


def wire_points(
    xyz: NDArray[np.floating],
    height: NDArray[np.floating],
    probability: NDArray[np.floating],
    *,
    core: NDArray[np.bool_],
    origin: NDArray[np.float64],
) -> pd.DataFrame:
    """Return the points of wires in the core of a scene, thinned to one per cube of `CELL`."""
    rows = np.flatnonzero((probability >= LIKELY) & core)
    if len(rows) == 0:
        return no_wire_points()
    places = xyz[rows].astype(np.float64) + origin
    _, cell = np.unique(np.floor(places / CELL).astype(np.int64), axis=0, return_inverse=True)
    cell = cell.ravel()
    count = np.bincount(cell)
    means = np.column_stack([np.bincount(cell, places[:, k]) / count for k in range(3)])
    lowest = np.full(len(count), np.inf)
    np.fmin.at(lowest, cell, height[rows].astype(np.float64))
    lowest[np.isinf(lowest)] = np.nan
    likely = np.bincount(cell, probability[rows]) / count
    return pd.DataFrame(np.column_stack([means, lowest, likely]), columns=list(WIRE_COLUMNS))


def join_wires(
    scenes: Sequence[pd.DataFrame], trajectory: Trajectory | None = None, *, least_score: float = LEAST_SCORE
) -> pd.DataFrame:
    """Return the wires of a pass as lines.

    A wire is a parabola in an upright plane, which differs from a catenary by millimetres where the sag is a tenth of
    the span or less.
    """
    filled = [table for table in scenes if len(table)]
    if not filled:
        return line_table([])
    points = np.concatenate([table[list(WIRE_COLUMNS)].to_numpy(dtype=np.float64) for table in filled])
    origin = np.append(np.floor(points[0, :3]), [0.0, 0.0])
    wires = [wire for wire in Wires(points - origin).found() if wire.score >= least_score]
    return line_table([_row(wire, origin, trajectory) for wire in wires])


def _row(wire: Wire, origin: NDArray[np.float64], trajectory: Trajectory | None) -> dict[str, object]:
    low, high = wire.ends
    way = np.linspace(low, high, max(3, int(np.ceil((high - low) / _SPACING)) + 1))
    vertices = wire.at(way)
    chord = np.interp(way, [low, high], vertices[[0, -1], 2])
    vertices += origin[:3]
    measures = {"sag": float(max((chord - vertices[:, 2] + origin[2]).max(), 0.0)), "clearance": wire.clearance}
    measures["score"] = wire.score
    return line_row("wire", vertices, trajectory, **measures)
