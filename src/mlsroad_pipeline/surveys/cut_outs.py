"""Small parts of labelled clouds around given places, for pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.registry import get_format

CHUNK = 2_000_000
"""Points that are read at once."""
MOST_POINTS = 60_000
"""Largest number of points of a part; of more, evenly spaced ones are kept."""
CLASS = "classification"


class CutOut(NamedTuple):
    """Points around a place: coordinates relative to it (z as in the survey), and class codes."""

    xyz: NDArray[np.float32]
    code: NDArray[np.uint8]


def cut_out(clouds: Sequence[Path], places: NDArray[np.float64], reach: NDArray[np.float64]) -> list[CutOut]:
    """Return the points within `reach` in x and y of each place; clouds are read once, in parts."""
    parts: list[list[CutOut]] = [[] for _ in places]
    for path in clouds:
        form = get_format(path)
        info = form.info(path, ReadOptions())
        only = tuple(name for name in (CLASS,) if name in info.columns)
        for start in range(0, info.n_points, CHUNK):
            cloud = form.read(path, ReadOptions(only=only), start=start, stop=start + CHUNK)
            code = cloud[CLASS].astype(np.uint8) if only else np.zeros(len(cloud), np.uint8)
            for part, place, half in zip(parts, places, reach, strict=True):
                shift = np.array([*place, 0.0]) - cloud.origin
                near = np.flatnonzero(np.abs(cloud.xyz[:, :2] - shift[:2]).max(axis=1) <= half)
                part.append(CutOut((cloud.xyz[near] - shift).astype(np.float32), code[near]))
    return [_joined(part) for part in parts]


def _joined(part: Sequence[CutOut]) -> CutOut:
    if not part:
        return CutOut(np.empty((0, 3), np.float32), np.empty(0, np.uint8))
    xyz, code = np.concatenate([piece.xyz for piece in part]), np.concatenate([piece.code for piece in part])
    step = -(-len(xyz) // MOST_POINTS) or 1
    return CutOut(xyz[::step], code[::step])
