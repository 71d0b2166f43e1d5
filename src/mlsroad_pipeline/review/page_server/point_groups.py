"""Groups of points to look at first, beside the objects: those that are probably wrong, large, and can be judged.

A group is a unit of the answers that `mlsroad learn` uses: connected points of one class within a few metres. Groups
are found on a sample of the tiles, the points of a group on all tiles.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.codings import NOISE_CODES
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.inventory.objects.doubts import CELL as CLUSTER_CELL
from mlsroad_pipeline.algorithms.inventory.objects.doubts import LEAST_POINTS, Cells, doubtful_clusters, worth_of_look
from mlsroad_pipeline.algorithms.models.boosted_trees.segments import (
    CELL,
    GAP,
    Segments,
    find_segments,
)
from mlsroad_pipeline.review.page_server.selection import Near, TooManyPointsError, cluster
from mlsroad_pipeline.review.page_server.tile_format import TileIndex, depth, spacing
from mlsroad_pipeline.review.painted import NONE, Painted

SAMPLED = 250_000
"""Largest number of points of the sample, which bounds memory; of larger surveys cubes at equal steps are used."""
_SPACING = 0.4  # of the sample, metres
_FEWEST = 6  # cells of a group
_TRIED, _TRIES = 100, 3  # groups whose points are counted: at least, and per group that is requested
_COLUMN = 4.0  # edge of the columns whose lowest point gives heights, metres
_NEAREST = 20_000  # points whose nearest neighbours give the spacing of a sparse survey


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

    def select(self, index: NDArray) -> _Sample:
        """Return the points of an index."""
        return _Sample(*(column[index] for column in self))


class PointGroups:
    """Groups of the points of a survey that belong to no object."""

    def __init__(
        self, tiles: TileIndex, *, names: Mapping[int, str] | None = None, path: NDArray[np.float64] | None = None
    ) -> None:
        sample = _thinned(_sampled(tiles))
        height = _heights(sample.xyz)
        free = np.flatnonzero(~sample.in_object & ~np.isin(sample.codes, NOISE_CODES))
        self._tiles, self._sample = tiles, sample.select(free)
        self._scale = _scale(self._sample.xyz)
        self._segments = _segmented(self._sample, height[free], self._scale)
        self._places = _middle_points(self._sample.xyz, self._segments)
        doubtful = _doubtful(sample, height, names or {}, self._scale)[free]
        self._facts = _facts(self._sample, self._segments, self._places, doubtful, names or {}, path)
        self._counted: dict[int, tuple[int, int]] = {}
        self._left_out: set[int] = set()

    def first(self, number: int, painted: Painted = NONE) -> list[PointGroup]:
        """Return the groups that are worth a look most; painted ones count as answered, and are left out."""
        return [self._described(segment) for segment in self.order(number, painted)]

    def order(self, number: int, painted: Painted = NONE) -> list[int]:
        """Return the segments of the groups to look at first; of segments with the same points, the first alone."""
        segments = self._segments
        if not len(segments.size):
            return []
        done = np.isin(self._sample.rows, painted.rows) if len(painted.rows) else np.zeros(len(segments.owner), bool)
        share = np.bincount(segments.owner, weights=done, minlength=len(segments.size)) / segments.size
        open_ = (segments.size >= _FEWEST) & (share <= 0.5) & ~done[self._places]
        open_[sorted(self._left_out)] = False
        likely = np.argsort(-np.where(open_, self._worth(segments.size * LEAST_POINTS / _FEWEST), -1.0), kind="stable")
        tried = likely[: min(int(open_.sum()), max(_TRIED, _TRIES * number))]
        counts = np.array([self._count(int(segment))[0] for segment in tried])
        distinct: dict[tuple[int, int, int], int] = {}
        for segment in tried[np.argsort(-self._worth(counts, tried), kind="stable")].tolist():
            distinct.setdefault((int(self._codes[segment]), *self._count(segment)), segment)
        return list(distinct.values())[:number]

    @property
    def _codes(self) -> NDArray[np.uint8]:
        return self._sample.codes[self._places]

    def _worth(self, points: NDArray[np.number], rows: NDArray[np.int64] | slice = slice(None)) -> NDArray[np.float64]:
        name, confidence, extent, distance, is_doubtful = (column[rows] for column in self._facts)
        return worth_of_look(name, confidence, extent, points, distance, unlikely=is_doubtful)

    def _count(self, segment: int) -> tuple[int, int]:
        """Return the number of points of a group as labelled, and the first of their rows."""
        if segment not in self._counted:
            place = self._sample.xyz[self._places[segment]].astype(np.float64)
            rows = self.points(place, int(self._codes[segment])).rows
            self._counted[segment] = len(rows), int(rows[0]) if len(rows) else -1
        return self._counted[segment]

    def leave_out(self, place: NDArray[np.float64], *, back: bool = False) -> None:
        """Leave the group at a place out of the list, or take it back."""
        found = np.flatnonzero((np.abs(self._sample.xyz[self._places] - place) < 2e-3).all(axis=1))
        if not len(found):
            raise ParameterError("there is no group of points at this place")
        (self._left_out.difference_update if back else self._left_out.update)(found.tolist())

    def points(self, place: NDArray[np.float64], code: int, painted: Painted = NONE) -> Near:
        """Return the points of a class that are connected with a place, up to half a cell from it.

        Where these are too many for one stroke, the distance is halved.
        """
        reach = self._scale * CELL / 2
        while True:
            try:
                return cluster(self._tiles, place, code, painted, reach=reach, gap=self._scale * GAP)
            except TooManyPointsError:
                reach /= 2
                if reach < GAP:
                    raise

    def _described(self, segment: int) -> PointGroup:
        own, place = self._segments.owner == segment, self._places[segment]
        return {
            "place": [round(float(value), 3) for value in self._sample.xyz[place]],
            "code": int(self._sample.codes[place]),
            "confidence": round(float(self._sample.confidence[own].mean()), 3),
        }


def _doubtful(
    sample: _Sample, height: NDArray[np.float32], names: Mapping[int, str], scale: float
) -> NDArray[np.bool_]:
    """Return the points of the sample in clusters whose class is unlikely where they stand."""
    present, label = np.unique(sample.codes, return_inverse=True)
    cells = Cells(sample.xyz, height, label, [names.get(int(code), "") for code in present])
    return doubtful_clusters(cells, size=CLUSTER_CELL * scale, least=_FEWEST)[1] >= 0


def _facts(
    sample: _Sample,
    segments: Segments,
    places: NDArray[np.int64],
    doubtful: NDArray[np.bool_],
    names: Mapping[int, str],
    path: NDArray[np.float64] | None,
) -> tuple[NDArray, ...]:
    """Return class, mean confidence, vertical extent, distance from the path of each group, and whether in doubt."""
    n, size = len(segments.size), np.maximum(segments.size, 1)
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(low, segments.owner, sample.xyz[:, 2])
    np.maximum.at(high, segments.owner, sample.xyz[:, 2])
    away = np.full(n, np.nan)
    if path is not None and len(path) and n:
        away = cKDTree(path[:, :2]).query(sample.xyz[places, :2])[0]
    return (
        np.array([names.get(int(code), "") for code in sample.codes[places]], dtype=np.str_),
        np.bincount(segments.owner, weights=sample.confidence, minlength=n) / size,
        high - low,
        away,
        np.bincount(segments.owner, weights=doubtful, minlength=n) > size / 2,
    )


def _sampled(tiles: TileIndex) -> _Sample:
    """Return the points of the coarse levels, of all cubes or of cubes at equal steps."""
    levels, counts = tiles.nodes[:, 0], tiles.nodes[:, 5]
    coarse = [level for level in np.unique(levels).tolist() if level == 0 or spacing(tiles.edge, level) >= _SPACING]
    rows = np.flatnonzero(np.isin(levels, coarse))
    if not len(rows):
        return _joined([])
    deep = np.array([depth(int(level)) for level in levels[rows]])
    _, cube = np.unique(tiles.nodes[rows, 1:4] >> deep[:, None], axis=0, return_inverse=True)
    step = max(1, -(-int(counts[rows].sum()) // SAMPLED))
    return _joined([_read(tiles, row) for row in rows[cube.ravel() % step == 0].tolist()])


def _joined(parts: list[_Sample]) -> _Sample:
    if parts:
        return _Sample(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    none = np.zeros(0, np.float32)
    return _Sample(np.zeros((0, 3), np.float32), np.zeros(0, np.uint32), np.zeros(0, np.uint8), none, none > 0)


def _read(tiles: TileIndex, row: int) -> _Sample:
    xyz, chunk = tiles.load(row)
    confidence = (chunk.codes[:, 1] / np.float32(255)).astype(np.float32)
    return _Sample(xyz, chunk.rows, chunk.codes[:, 0], confidence, chunk.objects > 0)


def _thinned(sample: _Sample) -> _Sample:
    """Return one point per class and cell."""
    if not len(sample.rows):
        return sample
    cells = np.floor((sample.xyz - sample.xyz.min(axis=0)) / _SPACING).astype(np.int64)
    _, ny, nz = (int(n) + 1 for n in cells.max(axis=0))
    _, kept = np.unique(((cells[:, 0] * ny + cells[:, 1]) * nz + cells[:, 2]) * 256 + sample.codes, return_index=True)
    return sample.select(kept)


def _scale(xyz: NDArray[np.float32]) -> float:
    """Return how much larger cells and gaps are than usual: single scans have points farther apart than a gap."""
    if len(xyz) < 2:
        return 1.0
    some = xyz[:: max(1, len(xyz) // _NEAREST)]
    distance = cKDTree(xyz).query(some, k=2)[0][:, 1]
    return max(1.0, float(np.median(distance)) / GAP)


def _heights(xyz: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the height of each point above the lowest one of its column."""
    if not len(xyz):
        return np.zeros(0, np.float32)
    cells = np.floor((xyz[:, :2] - xyz[:, :2].min(axis=0)) / _COLUMN).astype(np.int64)
    _, column = np.unique(cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1], return_inverse=True)
    lowest = np.full(int(column.max()) + 1, np.inf, np.float32)
    np.minimum.at(lowest, column, xyz[:, 2])
    return (xyz[:, 2] - lowest[column]).astype(np.float32)


def _segmented(sample: _Sample, height: NDArray[np.float32], scale: float) -> Segments:
    """Return the groups; the classes that a point does not have share the rest of its probability."""
    present, label = np.unique(sample.codes, return_inverse=True)
    chosen = np.eye(len(present), dtype=np.float32)[label]
    own = np.maximum(sample.confidence, 1.01 / max(len(present), 1))  # its class stays the most probable one
    rest = (1 - own) / max(len(present) - 1, 1)
    values = np.column_stack([height, sample.confidence, chosen]).astype(np.float32)
    return find_segments(sample.xyz / scale, values, chosen * (own - rest)[:, None] + rest[:, None])


def _middle_points(xyz: NDArray[np.float32], segments: Segments) -> NDArray[np.int64]:
    """Return the point of each segment that is nearest to the middle of its points."""
    owner, size = segments.owner, segments.size
    middle = np.stack([np.bincount(owner, weights=xyz[:, axis]) / size for axis in range(3)], axis=1)
    distance = ((xyz - middle[owner]) ** 2).sum(axis=1)
    order = np.lexsort((distance, owner))
    return order[np.cumsum(size) - size].astype(np.int64)
