"""Markings of a survey: the bright stripes of each scene, and lines through those of all scenes."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_row, line_table
from mlsroad_pipeline.algorithms.inventory.lines.markings.brightness import SCANNER_BITS, joined_cells, road_cells
from mlsroad_pipeline.algorithms.inventory.lines.markings.kinds import Marking, markings_of
from mlsroad_pipeline.algorithms.inventory.lines.markings.stripes import Stripes, find_stripes
from mlsroad_pipeline.algorithms.inventory.lines.markings.tracing import trace_markings
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import GROUPS, group_shares
from mlsroad_pipeline.algorithms.inventory.objects.table import empty_table
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

STRIPE_COLUMNS = ("x", "y", "z", "along_x", "along_y", "width", "clearness", "contrast")
"""Columns of the stripes of a scene: place in world coordinates, direction, width, clearness, contrast."""

LEAST_LENGTH, LEAST_CONTRAST = 0.8, 2.0
"""Shorter lines are left out, metres; so are stripes of less contrast, standard deviations of the road."""

_BAND = (-0.3, 0.25)  # heights above the ground, metres
_PLACE, _MOSTLY = 2.0, 0.75  # metres; share of paved ground in 3 by 3 such squares
_PAVED = GROUPS.index("paved ground")
_STRAIGHT = 0.02  # vertices nearer than this to a straight line are left out, metres


def paved_classes(scheme: ClassScheme) -> NDArray[np.bool_]:
    """Return which classes of a scheme are paved ground, shape (classes,)."""
    return np.asarray(group_shares(scheme)[:, _PAVED] > 0.5)


def no_stripes() -> pd.DataFrame:
    """Return a table of stripes without rows."""
    return empty_table(dict.fromkeys(STRIPE_COLUMNS, "float64"))


def marking_stripes(
    xyz: NDArray[np.floating],
    height: NDArray[np.floating],
    labels: NDArray[np.integer],
    intensity: NDArray[np.floating],
    scanner_pass: NDArray[np.integer],
    *,
    is_paved: NDArray[np.bool_],
    is_ground: NDArray[np.bool_],
    core: NDArray[np.bool_],
    origin: NDArray[np.float64],
    least_contrast: float = LEAST_CONTRAST,
) -> pd.DataFrame:
    """Return the bright stripes of the road in the core of a scene."""
    low = (height > _BAND[0]) & (height < _BAND[1])  # false where the height is NaN
    low &= np.isfinite(intensity)
    road = _road(xyz, low & np.append(is_paved, True)[labels], low & np.append(is_ground, True)[labels])
    tables = []
    for number in np.unique(scanner_pass[road] >> SCANNER_BITS):
        of_pass = np.flatnonzero(road & (scanner_pass >> SCANNER_BITS == number))
        scanner = scanner_pass[of_pass]
        each = [of_pass[scanner == k] for k in np.unique(scanner)]
        found = [cells for rows in each if len(cells := road_cells(xyz[rows], intensity[rows], core[rows]))]
        if found:
            s = find_stripes(joined_cells(found), least_contrast=least_contrast)
            values = [s.xyz + origin, s.along, *(v[:, None] for v in (s.width, s.clearness, s.contrast))]
            tables.append(pd.DataFrame(np.hstack(values), columns=list(STRIPE_COLUMNS)))
    return pd.concat(tables, ignore_index=True) if tables else no_stripes()


def _road(xyz: NDArray[np.floating], paved: NDArray[np.bool_], ground: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the points of the road: paved ground, and other ground where most of the ground around it is paved.

    Far from the scanner, few points of a road are labelled as other ground.
    """
    other = np.flatnonzero(ground & ~paved)
    if len(other) == 0 or not paved.any():
        return paved
    known = np.flatnonzero(ground | paved)
    low = np.floor(xyz[known, :2].min(axis=0) / _PLACE).astype(np.int64) - 1
    place = np.floor(xyz[known, :2] / _PLACE).astype(np.int64) - low
    shape = place.max(axis=0) + 2
    flat = place @ (shape[1], 1)
    count, of_paved = (np.bincount(flat, weights, np.prod(shape)).reshape(shape) for weights in (None, paved[known]))
    around = ndimage.convolve(of_paved - _MOSTLY * count, np.ones((3, 3)), mode="constant") > 0
    road = paved.copy()
    road[known[around.ravel()[flat]]] = True
    return road


def join_markings(
    scenes: Sequence[pd.DataFrame],
    trajectory: Trajectory | None = None,
    *,
    kerbs: pd.DataFrame | None = None,
    least_length: float = LEAST_LENGTH,
) -> pd.DataFrame:
    """Return the markings of a pass as lines."""
    filled = [table for table in scenes if len(table)]
    if not filled:
        return line_table([])
    values = np.concatenate([table[list(STRIPE_COLUMNS)].to_numpy(dtype=np.float64) for table in filled])
    stripes = Stripes(values[:, :3], values[:, 3:5], values[:, 5], values[:, 6], values[:, 7])
    edges = [] if kerbs is None else [_vertices(text) for text in kerbs["line"]]
    lines = trace_markings(stripes, least_length=least_length)
    return line_table([_row(marking, trajectory) for marking in markings_of(lines, trajectory, edges)])


def _vertices(text: str) -> NDArray[np.float64]:
    return np.asarray(shapely.get_coordinates(shapely.from_wkt(text), include_z=True))


def _without_straight(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the vertices without those on a straight line, in plan and in height."""
    number = np.arange(len(vertices))
    station = np.append(0.0, np.hypot(*np.diff(vertices[:, :2], axis=0).T).cumsum())
    lines = [np.column_stack([*pair, number]) for pair in (vertices[:, :2].T, (station, vertices[:, 2]))]
    kept = shapely.get_coordinates(shapely.simplify([shapely.LineString(v) for v in lines], _STRAIGHT), include_z=True)
    return vertices[np.unique(kept[:, 2].astype(np.int64))]


def _row(marking: Marking, trajectory: Trajectory | None) -> dict[str, object]:
    return line_row(
        *(marking.kind, _without_straight(marking.vertices), trajectory),
        score=marking.score,
        width=marking.width,
        contrast=marking.contrast,
        pattern=marking.pattern,
    )
