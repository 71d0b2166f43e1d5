"""Plates of signs among points of any class: pieces of surfaces whose probability of a sign is raised, and features.

A plate on a mast, before foliage or on a facade has points of another class. The probability of a sign still rises
there, from below 0.01 to 0.1 or more. Points above several levels form pieces, and a classifier tells by their shape
and surroundings which of them are plates.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.objects.class_groups import GROUPS
from mlsroad_pipeline.algorithms.inventory.objects.evidence import GROUP_FEATURES, SUMS, SceneCells, group_features
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster

PLATE = "plate"
"""Name of the classifier of plates: plate of a sign or not."""

PLATE_SHAPE = (
    "level", "mean_sign", "most_sign", "log_points", "low", "high", "tall", "wide", "deep", "thickness", "second",
    "first", "tilt", "filled", "log_density",
)  # fmt: skip
"""Features of a piece: its level, probabilities of a sign, heights above the ground, extents along the vertical, along
and across its plane, standard deviations along its axes, vertical part of its normal, share of filled squares; m."""

PLATE_FEATURES = (*PLATE_SHAPE, *GROUP_FEATURES)
"""Names of the features of a piece."""

LEVELS = (0.06, 0.15, 0.35)
"""Least probabilities of a sign of the points of a piece."""

_TOLERANCE = 0.25  # distance between points of a piece, metres
_LEAST_POINTS = 8
_LOWEST = 0.3  # height above the ground below which points are left out, metres
_LARGEST = 4.0  # largest extent of a piece, metres: boards on gantries are larger, and labelled well
_SQUARE = 0.15  # of the plane of a piece, metres


class Plates(NamedTuple):
    """Pieces of a scene that may be plates; those of different levels overlap."""

    features: NDArray[np.float32]  # `PLATE_FEATURES` of each piece
    members: list[NDArray[np.int64]]  # points of each piece


def find_plates(
    local: NDArray[np.floating], height: NDArray[np.floating], sign: NDArray[np.floating], cells: SceneCells
) -> Plates:
    """Find pieces that may be plates; `sign` is the probability of a sign of each point of the scene."""
    features, members = [np.zeros((0, len(PLATE_FEATURES)), np.float32)], []
    for level in LEVELS:
        points = np.flatnonzero((sign >= level) & (height >= _LOWEST))
        if len(points) < _LEAST_POINTS:
            break
        xyz = local[points].astype(np.float64)
        pieces = _pieces(xyz)
        if not pieces:
            continue
        owner = np.full(len(points), -1)
        for k, rows in enumerate(pieces):
            owner[rows] = k
        mine = np.flatnonzero(owner >= 0)
        table = cells.around(points[mine], owner[mine])
        sums = np.zeros((len(pieces), len(SUMS)))
        np.add.at(sums, table["fragment"].to_numpy(), table[list(SUMS)].to_numpy(dtype=np.float64))
        shape = [_shape(xyz[rows], height[points[rows]], sign[points[rows]], level) for rows in pieces]
        features.append(np.concatenate([np.array(shape), group_features(sums)], axis=1).astype(np.float32))
        members += [points[rows] for rows in pieces]
    return Plates(np.concatenate(features), members)


def _pieces(xyz: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """Return the points of each cluster with enough of them that is not too large."""
    number = cluster(xyz, tolerance=_TOLERANCE)
    order = np.argsort(number, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(number[order])) + 1)
    large = [rows for rows in groups if len(rows) >= _LEAST_POINTS]
    return [rows for rows in large if np.ptp(xyz[rows], axis=0).max() <= _LARGEST]


def _shape(
    xyz: NDArray[np.float64], height: NDArray[np.floating], sign: NDArray[np.floating], level: float
) -> list[float]:
    """Return the features of `PLATE_SHAPE`."""
    off = xyz - xyz.mean(axis=0)
    spread, axes = np.linalg.eigh(off.T @ off / len(off))
    deviation = np.sqrt(np.maximum(spread, 0.0))
    plan = np.linalg.eigh(off[:, :2].T @ off[:, :2] / len(off))[1]
    across, along = (off[:, :2] @ plan).T
    square = np.floor(np.column_stack([along, off[:, 2]]) / _SQUARE).astype(np.int64)
    size = np.ptp(square, axis=0) + 1
    wide, tall = float(np.ptp(along)), float(np.ptp(off[:, 2]))
    return [
        level, float(sign.mean()), float(sign.max()), float(np.log(len(xyz))), float(height.min()),
        float(height.max()), tall, wide, float(np.ptp(across)), *deviation.tolist(), float(abs(axes[2, 0])),
        len(np.unique(square, axis=0)) / float(size.prod()),
        float(np.log(len(xyz) / max(wide * tall, 0.01))),
    ]  # fmt: skip


def chosen_plates(plates: Plates, probability: NDArray[np.float64], least: float) -> NDArray[np.int64]:
    """Return the points of the most probable pieces that do not overlap, from a least probability on."""
    taken: set[int] = set()
    for k in np.argsort(-probability, kind="stable"):
        if probability[k] < least:
            break
        rows = plates.members[k].tolist()
        if taken.isdisjoint(rows):
            taken.update(rows)
    return np.array(sorted(taken), dtype=np.int64)


SIGN = GROUPS.index("sign")
"""Column of the group of signs."""
