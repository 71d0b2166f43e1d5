"""Sight to signs: from where on the path before a sign its panel is seen uninterrupted.

What stands is a set of voxels with points. The eye is `EYE` above the road on the path (Augpunkt of RAL, 1.00 m).
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.objects.table import Field
from mlsroad_pipeline.algorithms.inventory.road.stations import STEP, RoadPath

SIGHT_FIELDS: dict[str, Field] = {
    "object_id": Field("int64", "Sign", "Number of the sign in the inventory."),
    "station": Field("float64", "Station [m]", "Of the sign along the path."),
    "offset": Field("float64", "Offset [m]", "Of the sign from the path, positive to the right."),
    "sight": Field("float64", "Sight [m]", "Way to the sign from where on its panel is seen uninterrupted."),
    "sight_end": Field(
        *("str", "Sight ends", "hidden, turn (of path or panel), start (of the path) or limit (150 m)."),
        ("hidden", "turn", "start", "limit"),
    ),
    "hidden_by": Field("str", "Hidden by", "Class of what hides it before, where it is hidden."),
    "hidden_x": Field("float64", "Hidden at easting [m]", "First coordinate of what hides it."),
    "hidden_y": Field("float64", "Hidden at northing [m]", "Second coordinate of what hides it."),
}
"""Columns of the sight to signs: a row per sign and pass of the path that its front faces."""

EYE, FARTHEST, BESIDE = 1.0, 150.0, 15.0
"""Height of the eye above the road, longest sight, and largest distance of a sign from the path, metres."""

_CELL = 0.25  # edge of a voxel, metres
_LEAST = 2  # points of a voxel that hides
_NEAR_EYE, _NEAR_SIGN = 3.0, 0.75  # parts of a line of sight at its ends where nothing hides, metres
_HIGH = (0.3, 8.0)  # heights above the path's road of what may hide, metres
_FRONT, _AHEAD = np.cos(np.radians(60.0)), np.cos(np.radians(30.0))  # from the front of a panel; from the way ahead


class Standing(NamedTuple):
    """Voxels with points of what stands beside the road."""

    key: NDArray[np.int64]  # Sorted
    count: NDArray[np.int64]
    label: NDArray[np.uint8]  # Class of one of the points


def voxel_keys(xyz: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the numbers of the voxels of places, world coordinates within 65 km of each other."""
    cell = np.floor(xyz / _CELL).astype(np.int64) & ((1 << 18) - 1)
    return np.asarray((cell[..., 0] << 36) | (cell[..., 1] << 18) | cell[..., 2])


def standing(xyz: NDArray[np.float64], label: NDArray[np.uint8]) -> Standing:
    """Return the voxels of points."""
    key, first, count = np.unique(voxel_keys(xyz), return_index=True, return_counts=True)
    return Standing(key, count, label[first])


def joined(parts: list[Standing]) -> Standing:
    """Return the voxels of several parts of the points."""
    key, first, of_part = np.unique(np.concatenate([p.key for p in parts]), return_index=True, return_inverse=True)
    count = np.bincount(of_part, np.concatenate([p.count for p in parts]), len(key)).astype(np.int64)
    return Standing(key, count, np.concatenate([p.label for p in parts])[first])


def may_hide(height: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which points may hide a sign, by their heights above the road."""
    return np.asarray((height > _HIGH[0]) & (height < _HIGH[1]))


def sight_table(
    signs: pd.DataFrame, path: RoadPath, road: NDArray[np.float64], things: Standing, classes: list[str]
) -> pd.DataFrame:
    """Return the sight to signs with a known panel; `road` are the heights of the road, NaN where it is not known."""
    signs = signs[signs["facing"].notna() & signs["panel_centre"].notna()]
    known = np.flatnonzero(np.isfinite(road))
    eyes = path.middles.copy()
    eyes[:, 2] = np.interp(np.arange(len(path)), known, road[known]) + EYE
    kept = things.count >= _LEAST
    walls = Standing(things.key[kept], things.count[kept], things.label[kept])
    panels = np.column_stack([signs["x"], signs["y"], signs["z"] + signs["panel_centre"]]).astype(np.float64)
    places, rows = path.locate(panels), []
    for row, station, offset in zip(*places, strict=True):
        if abs(offset) <= BESIDE:
            sign = signs.iloc[int(row)]
            found = _sight(panels[row], sign, station, eyes, path, walls, classes)
            if found is not None:
                place = {"object_id": sign["object_id"], "station": station, "offset": offset}
                rows.append(place | dict(zip(list(SIGHT_FIELDS)[3:], found, strict=True)))
    table = pd.DataFrame(rows, columns=list(SIGHT_FIELDS)).astype({n: f.dtype for n, f in SIGHT_FIELDS.items()})
    return table.sort_values(["station", "object_id"], ignore_index=True).round(2)


def _sight(
    panel: NDArray[np.float64], sign: pd.Series, station: float, eyes: NDArray[np.float64], path: RoadPath,
    walls: Standing, classes: list[str],
) -> tuple[float, str, str, float, float] | None:  # fmt: skip
    """Return `sight`, `sight_end` and what hides; None where the front faces no place of the path before the sign."""
    rows = np.arange(max(int((station - FARTHEST) / STEP), 0), min(int(station / STEP) + 1, len(eyes)))[::-1]
    away = panel[:2] - eyes[rows, :2]
    away /= np.maximum(np.hypot(*away.T), 1e-9)[:, None]
    turn = np.radians(float(sign["facing"]))
    front = -away @ [np.sin(turn), np.cos(turn)]
    front = np.abs(front) if sign["facing_from"] == "unknown" else front
    rows = rows[(front > _FRONT) & ((away * path.forward[rows]).sum(axis=1) > _AHEAD)]
    if not len(rows):
        return None
    last = rows[0]
    for row in rows:
        if last - row > 1:  # the path turns away in between
            break
        wall = _first_wall(eyes[row], panel, walls)
        if wall is not None:
            seen = 0.0 if row == rows[0] else station - (last + 0.5) * STEP
            return seen, "hidden", [*classes, ""][min(wall[0], len(classes))], *wall[1]
        last = row
    seen = station - (last + 0.5) * STEP
    return seen, "start" if last == 0 else "limit" if seen > FARTHEST - 2 * STEP else "turn", "", np.nan, np.nan


def _first_wall(
    eye: NDArray[np.float64], panel: NDArray[np.float64], walls: Standing
) -> tuple[int, tuple[float, float]] | None:
    """Return class and place of the first voxel that hides a panel; None where it is seen."""
    length = float(np.linalg.norm(panel - eye))
    at = np.arange(_NEAR_EYE, length - _NEAR_SIGN, _CELL / 3)
    line = eye + (panel - eye) * (at / length)[:, None]
    key = voxel_keys(line)
    found = np.minimum(np.searchsorted(walls.key, key), max(len(walls.key) - 1, 0))
    hits = np.flatnonzero(walls.key[found] == key) if len(walls.key) else np.zeros(0, np.int64)
    if not len(hits):
        return None
    return int(walls.label[found[hits[0]]]), (float(line[hits[0], 0]), float(line[hits[0], 1]))
