"""Separation of vehicles that stand so close that their points form one object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.objects.boxes import vehicle_box
from mlsroad_pipeline.algorithms.inventory.objects.object_voxels import Voxels

LONGEST, WIDEST = 5.8, 2.7
"""Length and width of an object that may be a single car or van; larger ones may be rows, metres."""

TALLEST = 2.6
"""Height above which an object is a lorry or a bus, which has no gap down to the ground, metres."""

_LOW, _HIGH = 0.8, 1.1  # heights that a gap between bumpers stays below, and that a vehicle on either side exceeds, m
_BIN = 0.1  # of the profile, metres
_LEAST = 1.2  # shortest part, metres: less is hidden of the nearer of two vehicles


def split_row(voxels: Voxels) -> NDArray[np.int32]:
    """Divide a row of vehicles at gaps that go down to the ground.

    The profile of an object is its largest height in bins of 0.1 m along a side of its box.
    """
    part = np.zeros(len(voxels.xyz), dtype=np.int32)
    base = float(np.quantile(voxels.z_low, 0.02))
    if float(np.quantile(voxels.z_high, 0.99)) - base > TALLEST:
        return part
    top = voxels.z_high - base
    waiting, n_parts = [np.arange(len(part))], 0
    while waiting:
        rows = waiting.pop()
        cut = _cut(voxels.xyz[rows, :2], top[rows])
        if cut is None:
            part[rows] = n_parts
            n_parts += 1
        else:
            waiting += [rows[cut], rows[~cut]]
    return part


def _cut(xy: NDArray[np.float64], top: NDArray[np.float64]) -> NDArray[np.bool_] | None:
    """Return which voxels lie behind the deepest gap of an object larger than a car; None without one."""
    box = vehicle_box(xy)
    turn = np.radians(box.azimuth)
    length, width = np.array([np.sin(turn), np.cos(turn)]), np.array([np.cos(turn), -np.sin(turn)])
    for axis, size, largest in ((length, box.length, LONGEST), (width, box.width, WIDEST)):
        along = (xy - box.centre) @ axis
        place = _gap(along, top) if size > largest else None
        if place is not None:
            return np.asarray(along >= place)
    return None


def _gap(along: NDArray[np.float64], top: NDArray[np.float64]) -> float | None:
    """Return the place of the deepest gap of a profile, None without one."""
    first = float(along.min())
    of_bin = ((along - first) / _BIN).astype(np.int64)
    profile = np.zeros(int(of_bin.max()) + 1)
    np.maximum.at(profile, of_bin, top)
    high = np.flatnonzero(profile > _HIGH)
    margin = round(_LEAST / _BIN)
    if not len(high):
        return None
    bins = np.arange(len(profile))
    inside = (bins > high[0]) & (bins < high[-1]) & (bins >= margin) & (bins < len(profile) - margin)
    low = np.flatnonzero(inside & (profile < _LOW))
    if not len(low):
        return None
    deepest = low[profile[low] == profile[low].min()]
    runs = np.split(deepest, np.flatnonzero(np.diff(deepest) > 1) + 1)
    run = max(runs, key=len)
    return first + (float(run[0] + run[-1] + 1) / 2) * _BIN
