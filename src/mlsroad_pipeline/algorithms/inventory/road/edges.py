"""Edges of the carriageway at each station: kerbs, and borders of paved to natural ground."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.road.stations import STEP, RoadPath
from mlsroad_pipeline.algorithms.inventory.road.surface import CELL, CELLS, Ground

KERB, BRIDGED, PAVED, UNSEEN = "kerb", "kerb_bridged", "paved", ""
"""Evidence of an edge: a kerb; kerbs before and after it; the end of paved ground; none."""

NEAREST = 0.8
"""Smallest distance of an edge from the path, metres: half the width of a vehicle."""

_SAMPLE = 0.1  # of kerb lines, metres
_RISING = 0.5  # cosine between the rise of a kerb and the direction away from the path
_AROUND, _LEAP = 15, 2.5  # stations before and after a kerb, and how much farther it may be than most, metres
_GAP, _CHANGE = 12, 0.4  # stations that are bridged between kerbs, and their largest difference in offset, metres
_END, _TURN = (
    2,
    0.3,
)  # stations before and after a gap, and the change in offset there from which on a kerb turns, metres
_KERB_NEAR = 10  # stations from a kerb within which the end of paved ground is no edge
_ROUND = 1  # stations before and after one whose ground is counted together
_NATURAL = 3  # neighbouring cells of natural ground that end the paved ground
_HOLE = 3  # cells without points within it
_BESIDE, _AGREE = (
    5,
    0.5,
)  # stations around an end of paved ground, and the distance within which they confirm it, metres


class Edges(NamedTuple):
    """Offsets of the edges on the left (negative) and right of each station, metres, NaN without; their evidence."""

    offset: NDArray[np.float64]  # (2, stations)
    evidence: NDArray[np.str_]  # (2, stations)

    @property
    def width(self) -> NDArray[np.float64]:
        """Width of the carriageway, NaN where an edge is not seen."""
        return self.offset[1] - self.offset[0]


def find_edges(path: RoadPath, ground: Ground, kerbs: Sequence[NDArray[np.float64]]) -> Edges:
    """Return the edges of the carriageway; `kerbs` are lines along the feet of kerbs with their upper side left."""
    kerb = kerb_offsets(path, kerbs)
    bridged = np.stack([_bridged(side) for side in kerb])
    paved = paved_ends(ground)
    for side in range(2):
        near = np.convolve(np.isfinite(kerb[side]), np.ones(2 * _KERB_NEAR + 1), mode="same") > 0
        paved[side, near[: paved.shape[1]]] = np.nan
    offset = np.where(np.isfinite(bridged), bridged, paved)
    kinds = [np.isfinite(kerb), np.isfinite(bridged), np.isfinite(paved)]
    return Edges(offset, np.select(kinds, [KERB, BRIDGED, PAVED], UNSEEN))


def kerb_offsets(path: RoadPath, kerbs: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the offset of the nearest kerb that rises away from the path, by side and station; NaN without one."""
    out = np.full((2, len(path)), np.nan)
    parts = [_sampled(line[:, :2], number) for number, line in enumerate(kerbs) if len(line) > 1]
    if not parts:
        return out
    xy, along, number = (np.concatenate(column) for column in zip(*parts, strict=True))
    row, station, offset = path.locate(np.column_stack([xy, np.zeros(len(xy))]))
    at, side = (station / STEP).astype(np.int64), (offset > 0).astype(np.int64)
    forward, along = path.forward[at], along[row]
    rise = np.column_stack([-along[:, 1], along[:, 0]])
    outward = np.column_stack([forward[:, 1], -forward[:, 0]]) * np.where(side > 0, 1.0, -1.0)[:, None]
    rising = (rise * outward).sum(axis=1)
    columns = {"side": side, "at": at, "line": number[row], "offset": np.abs(offset)}
    table = pd.DataFrame(columns).assign(away=rising > 0)[(np.abs(rising) > _RISING) & (np.abs(offset) > NEAREST)]
    medians = table.groupby(["side", "at", "line", "away"])["offset"].median().reset_index()
    nearest = medians.loc[medians.groupby(["side", "at"])["offset"].idxmin()]
    nearest = nearest[nearest["away"]]  # the other side of an island means that its near side was not found
    sides = nearest["side"].to_numpy()
    out[sides, nearest["at"].to_numpy()] = np.where(sides > 0, 1.0, -1.0) * nearest["offset"].to_numpy()
    return _without_leaps(out)


def _without_leaps(offset: NDArray[np.float64]) -> NDArray[np.float64]:
    """Leave out kerbs that are much farther away than those before and after them: of the other carriageway."""
    padded = np.pad(offset, ((0, 0), (_AROUND, _AROUND)), constant_values=np.nan)
    around = np.abs(np.lib.stride_tricks.sliding_window_view(padded, 2 * _AROUND + 1, axis=1))
    common = pd.DataFrame(around.reshape(-1, around.shape[2])).median(axis=1).to_numpy().reshape(offset.shape)
    return np.where(np.abs(offset) > common + _LEAP, np.nan, offset)


def _sampled(
    line: NDArray[np.float64], number: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return places along a line, the direction of each, and the number of the line."""
    step = np.diff(line, axis=0)
    length = np.hypot(*step.T)
    way = np.concatenate([[0.0], np.cumsum(length)])
    at = np.arange(_SAMPLE / 2, way[-1], _SAMPLE)
    segment = np.clip(np.searchsorted(way, at, side="right") - 1, 0, len(step) - 1)
    share = (at - way[segment]) / np.maximum(length[segment], 1e-9)
    along = step[segment] / np.maximum(length[segment], 1e-9)[:, None]
    return line[segment] + share[:, None] * step[segment], along, np.full(len(at), number)


def _bridged(offset: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return offsets with gaps filled between kerbs at nearly the same distance, which do not turn away there."""
    out, known = offset.copy(), np.flatnonzero(np.isfinite(offset))
    for a, b in pairwise(known.tolist()):
        turns = np.array([offset[max(a - _END, 0)] - offset[a], offset[min(b + _END, len(offset) - 1)] - offset[b]])
        steady = not (np.abs(turns) > _TURN).any()  # an end that is not known turns nowhere
        if 1 < b - a <= _GAP + 1 and abs(offset[b] - offset[a]) <= _CHANGE and steady:
            out[a + 1 : b] = np.interp(np.arange(a + 1, b), [a, b], offset[[a, b]])
    return out


def paved_ends(ground: Ground) -> NDArray[np.float64]:
    """Return where paved ground ends at natural ground, by side and station; NaN where that is not seen."""
    found = _paved_ends(ground.number, ground.natural)
    padded = np.pad(found, ((0, 0), (_BESIDE, _BESIDE)), constant_values=np.nan)
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * _BESIDE + 1, axis=1)
    confirmed = (np.abs(around - found[:, :, None]) <= _AGREE).sum(axis=2) > _BESIDE  # at the ends of a path, most
    return np.where(confirmed, found, np.nan)


@njit(cache=True, nogil=True)
def _paved_ends(count: NDArray, natural: NDArray) -> NDArray[np.float64]:
    n = len(count)
    out = np.full((2, n), np.nan)
    middle = CELLS // 2
    for i in range(n):
        low, high = max(i - _ROUND, 0), min(i + _ROUND + 1, n)
        for side in range(2):
            last, run, hole = -1, 0, 0
            for k in range(middle):
                c = middle + k if side else middle - 1 - k
                total, green = 0, 0
                for row in range(low, high):
                    total += count[row, c]
                    green += natural[row, c]
                if total == 0:
                    hole += 1
                    if hole > _HOLE and k * CELL > NEAREST:
                        break
                    continue
                hole = 0
                if 2 * green > total:
                    run += 1
                    if run == _NATURAL and last * CELL > NEAREST:
                        out[side, i] = (last + 1) * CELL * (1.0 if side else -1.0)
                        break
                else:
                    last, run = k, 0
    return out
