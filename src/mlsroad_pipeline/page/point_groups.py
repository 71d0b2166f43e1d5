"""Groups of points to look at first, beside the objects: least certain, large, and unlike those that were answered.

A group is a unit of the answers that `mlsroad learn` uses: connected points of one class within a few metres. Groups
are found on a sample of the tiles, the points of a group on all tiles.
"""

from __future__ import annotations

from typing import NamedTuple, TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines.boosted_trees.segments import (
    CELL,
    GAP,
    Segments,
    find_segments,
    order_of_questions,
)
from mlsroad_pipeline.page.selection import NONE, Painted, cluster
from mlsroad_pipeline.page.tile_format import TileIndex, spacing

SAMPLED = 3_000_000
"""Largest number of points of the sample."""
_SPACING = 0.4  # of the sample, metres
_FEWEST = 6  # cells of a group
_NOISE = (7, 18)  # LAS codes of noise
_COLUMN = 10  # cells along the edge of a column whose lowest point gives heights


class PointGroup(TypedDict):
    """A group: a point of it in local coordinates, its class code, and the mean confidence of its points."""

    place: list[float]
    code: int
    confidence: float


class _Sample(NamedTuple):
    """One point per class and cell."""

    xyz: NDArray[np.float32]
    rows: NDArray[np.uint32]
    codes: NDArray[np.uint8]
    confidence: NDArray[np.float32]
    in_object: NDArray[np.bool_]


class PointGroups:
    """Groups of the points of a survey that belong to no object.

    Parameters
    ----------
    tiles : TileIndex
        Tiles of the survey.
    """

    def __init__(self, tiles: TileIndex) -> None:
        sample = _sampled(tiles)
        free = np.flatnonzero(~sample.in_object & ~np.isin(sample.codes, _NOISE))
        height = _heights(sample.xyz)[free]
        self._xyz, self._rows, self._codes, self._confidence = (
            sample.xyz[free], sample.rows[free], sample.codes[free], sample.confidence[free]
        )  # fmt: skip
        self._segments = _segmented(self._xyz, height, self._codes, self._confidence)

    def first(self, number: int, painted: Painted = NONE) -> list[PointGroup]:
        """Return the groups whose answers teach most; those that are painted already count as answered."""
        segments = self._segments
        if not len(segments.size):
            return []
        done = np.isin(self._rows, painted.rows) if len(painted.rows) else np.zeros(len(self._rows), np.bool_)
        share = np.bincount(segments.owner, weights=done, minlength=len(segments.size)) / segments.size
        order = order_of_questions(segments, number, asked=np.flatnonzero(share > 0.5), least=_FEWEST)
        return [self._described(int(segment)) for segment in order]

    def _described(self, segment: int) -> PointGroup:
        own = np.flatnonzero(self._segments.owner == segment)
        middle = self._xyz[own].mean(axis=0)
        nearest = own[np.argmin(((self._xyz[own] - middle) ** 2).sum(axis=1))]
        return {
            "place": [round(float(value), 3) for value in self._xyz[nearest]],
            "code": int(self._codes[nearest]),
            "confidence": round(float(self._confidence[own].mean()), 3),
        }


def points_of_group(
    tiles: TileIndex, place: NDArray[np.float64], code: int, painted: Painted = NONE
) -> NDArray[np.uint32]:
    """Return the rows of the points of a class that are connected with a place, up to half a cell from it."""
    return cluster(tiles, place, code, painted, reach=CELL / 2, gap=GAP)


def _sampled(tiles: TileIndex) -> _Sample:
    """Return the sample: of the levels that are coarse enough, one point per class and cell."""
    levels, counts = tiles.nodes[:, 0], tiles.nodes[:, 5]
    wanted: list[int] = []
    total = 0
    for level in np.unique(levels).tolist():
        total += int(counts[levels == level].sum())
        if wanted and (total > SAMPLED or spacing(tiles.edge, level) < _SPACING / 2):
            break
        wanted += np.flatnonzero(levels == level).tolist()
    parts = [_thinned(tiles, row) for row in wanted]
    if not parts:
        empty = np.zeros(0, np.float32)
        return _Sample(np.zeros((0, 3), np.float32), np.zeros(0, np.uint32), np.zeros(0, np.uint8), empty, empty > 0)
    return _Sample(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _thinned(tiles: TileIndex, row: int) -> _Sample:
    """Return one point per class and cell of a node."""
    xyz, chunk = tiles.load(row)
    cells = np.floor((xyz - xyz.min(axis=0)) / _SPACING).astype(np.int64)
    size = cells.max(axis=0) + 1
    keys = ((cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2]) * 256 + chunk.codes[:, 0]
    _, kept = np.unique(keys, return_index=True)
    return _Sample(
        xyz[kept],
        chunk.rows[kept],
        chunk.codes[kept, 0],
        (chunk.codes[kept, 1] / np.float32(255)).astype(np.float32),
        chunk.objects[kept] > 0,
    )


def _heights(xyz: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the height of each point above the lowest one of its column."""
    if not len(xyz):
        return np.zeros(0, np.float32)
    edge = _COLUMN * _SPACING
    cells = np.floor((xyz[:, :2] - xyz[:, :2].min(axis=0)) / edge).astype(np.int64)
    _, column = np.unique(cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1], return_inverse=True)
    lowest = np.full(int(column.max()) + 1, np.inf, np.float32)
    np.minimum.at(lowest, column, xyz[:, 2])
    return (xyz[:, 2] - lowest[column]).astype(np.float32)


def _segmented(
    xyz: NDArray[np.float32],
    height: NDArray[np.float32],
    codes: NDArray[np.uint8],
    confidence: NDArray[np.float32],
) -> Segments:
    """Return the groups; the classes that a point does not have share the rest of its probability."""
    present, label = np.unique(codes, return_inverse=True)
    chosen = np.eye(len(present), dtype=np.float32)[label]
    own = np.maximum(confidence, 1.01 / max(len(present), 1))  # its class stays the most probable one
    rest = (1 - own) / max(len(present) - 1, 1)
    values = np.column_stack([height, confidence, chosen]).astype(np.float32)
    return find_segments(xyz, values, chosen * (own - rest)[:, None] + rest[:, None])
