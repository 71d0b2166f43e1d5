"""Changes of measures, from the points of both surveys around the axis of one object."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

AROUND = {"pole": 1.0, "sign": 1.0, "tree": 2.0}
"""Radius around the axis of an object in which its points are compared, metres."""
SLICE, NEAR_AXIS = 0.25, 0.3
"""Height of the slices of a shaft, and the radius around its axis in which they are taken, metres."""
FEWEST_SLICES, FEWEST_POINTS = 8, 3
"""Fewest slices that two surveys of a pole must share, and fewest points of each."""
CELL = 0.5
"""Edge of the cells of a crown whose tops are compared, metres."""
FEWEST_CELLS = 4
"""Fewest cells with points in both surveys."""
MET, FEWEST_MET = 0.12, 5
"""Distance of points of two surveys on one panel, metres, and the fewest points between the two lower edges."""

BEHIND = 0.3
"""Distance behind a panel from which a ray has passed it, metres."""


def turn_of_axis(before: NDArray[np.float64], after: NDArray[np.float64], first: pd.Series, second: pd.Series) -> float:
    """Return the angle between the axes of a pole, degrees, from the centres of slices that both surveys have.

    `first` and `second` are its rows in both inventories (x, y, z, height, tilt, lean_azimuth). The centres lie on the
    sides that the scanners saw, so only the change of their distance with height counts. A listed axis may follow a
    banner or a neighbour: the points are those near the own axis, near the first, near the second and near the
    vertical, and the smallest angle counts. NaN: too few slices.
    """
    top = min(float(first["height"]), float(second["height"]))
    upright, turns = pd.Series({**second, "tilt": 0.0}), []
    for near_before, near_after in ((first, second), (first, first), (second, second), (upright, upright)):
        centres = _centres(before, near_before, top), _centres(after, near_after, top)
        way = centres[1] - centres[0]
        both = np.flatnonzero(np.isfinite(way[:, 0]))
        if len(both) >= FEWEST_SLICES:
            i, j = np.triu_indices(len(both), len(both) // 3)
            # Median of the slopes between slices far apart (Theil and Sen): arms and plates are outliers.
            slope = np.median((way[both[j]] - way[both[i]]) / ((both[j] - both[i]) * SLICE)[:, None], axis=0)
            turns.append(float(np.degrees(np.arctan(np.hypot(*slope)))))
    return min(turns, default=np.nan)


def _centres(points: NDArray[np.float64], row: pd.Series, top: float) -> NDArray[np.float64]:
    """Return the median place of the points near the axis of a pole by slice; NaN where there are too few."""
    n = max(0, int(top / SLICE))
    centres = np.full((n, 2), np.nan)
    tilt, way = np.radians(float(row["tilt"])), np.radians(np.nan_to_num(float(row["lean_azimuth"])))
    lean = np.tan(np.nan_to_num(tilt)) * np.array([np.sin(way), np.cos(way)])
    up = points[:, 2] - float(row["z"])
    aside = points[:, :2] - row[["x", "y"]].to_numpy(dtype=np.float64) - up[:, None] * lean
    near = np.hypot(*aside.T) <= NEAR_AXIS
    number = np.floor(up / SLICE).astype(np.int64)
    for k in range(2, n):  # the lowest half metre is grass and kerbs
        own = points[near & (number == k), :2]
        if len(own) >= FEWEST_POINTS:
            centres[k] = np.median(own, axis=0)
    return centres


def growth_of_crown(before: NDArray[np.float64], after: NDArray[np.float64], middle: float) -> float:
    """Return the median change of the highest points of a crown in cells that both surveys have, metres.

    Only points above the elevation `middle` count. NaN: too few cells.
    """
    tops = []
    for points in (before, after):
        high = points[points[:, 2] > middle]
        cells = pd.MultiIndex.from_arrays([*np.floor(high[:, :2] / CELL).astype(np.int64).T])
        tops.append(pd.Series(high[:, 2], index=cells).groupby(level=[0, 1]).max())
    change = (tops[1] - tops[0]).dropna()
    return float(change.median()) if len(change) >= FEWEST_CELLS else np.nan


def panel_in_both(before: NDArray[np.float64], after: NDArray[np.float64], low: tuple[float, float]) -> float:
    """Return the share of the points between two lower edges of a panel that both surveys have.

    `low` are the elevations of the edge in both surveys; the points are those of the survey with the lower one. NaN:
    too few points.
    """
    own, other = (before, after) if low[0] < low[1] else (after, before)
    between = own[(own[:, 2] > min(low)) & (own[:, 2] < max(low) - MET)]
    if len(between) < FEWEST_MET or not len(other):
        return np.nan
    return float(np.isfinite(cKDTree(other).query(between, distance_upper_bound=MET)[0]).mean())


def rays_through_panel(panel: NDArray[np.float64], scanner: NDArray[np.float64], points: NDArray[np.float64]) -> int:
    """Return the number of rays from a scanner to points that cross a panel, given by its points.

    Rays along its plane cross it nowhere: they prove nothing about a thin plate.
    """
    middle = panel.mean(axis=0)
    reach = float(np.linalg.norm(panel - middle, axis=1).max()) + MET
    way = points - scanner
    length = np.linalg.norm(way, axis=1)
    along = np.einsum("ij,ij->i", middle - scanner, way) / np.maximum(length, 1e-9)
    aside = np.linalg.norm(middle - scanner - along[:, None] * (way / np.maximum(length, 1e-9)[:, None]), axis=1)
    rows = np.flatnonzero((aside <= reach) & (along > 0) & (along < length + reach))
    if len(panel) < 3 or not len(rows):
        return 0
    normal = np.linalg.svd(panel - middle, full_matrices=False)[2][2]
    slope = way[rows] @ normal
    share = ((middle - scanner[rows]) @ normal) / np.where(slope == 0, np.inf, slope)
    # Only what lies clearly behind the panel has passed it.
    passed = (share > 0) & ((1 - share) * length[rows] >= BEHIND)
    places = scanner[rows] + share[:, None] * way[rows]
    return int(np.isfinite(cKDTree(panel).query(places[passed], distance_upper_bound=MET)[0]).sum())
