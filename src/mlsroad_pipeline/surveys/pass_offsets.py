"""Offsets between the files and passes of a survey where they overlap, and points that several files hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.inventory.objects.sightings import NO_TIME, PASS_GAP, ROUTE, SECOND
from mlsroad_pipeline.algorithms.registration.network import Move, adjust
from mlsroad_pipeline.algorithms.registration.offset import Offset, offset_of_surfaces
from mlsroad_pipeline.algorithms.registration.surfaces import Surfaces, find_surfaces

CELL = 10.0
"""Edge length in plan of the cells that overlaps are found and measured in, metres."""

STRIDE = 20
"""Every point of so many finds the overlaps."""

NEAR = 2.0
"""Distance up to which points count for the cells beside theirs, metres: recordings that border have common cells."""

FEWEST_IN_CELL = 5
"""Fewest such points of a recording in a cell."""

FEWEST_CELLS, MOST_CELLS = 2, 40
"""Fewest common cells of a pair, and largest number that is measured, at equal steps."""

MOST_PAIRS = 60
"""Largest number of pairs that are measured, those with the most common cells."""

MOST_POINTS = 250_000
"""About the largest number of points of a recording that are used for a pair."""

SAME_WITH_TIME, SAME_WITHOUT = 0.05, 0.5
"""Least share of points with the coordinates (and the second) of points of another file that is reported."""

COPY = 0.9
"""Share of such points from which two recordings are one, whose offset needs no measurement."""


@dataclass
class Source:
    """A file of a survey, whose points can be read several times in chunks with the columns of `visit_columns`."""

    name: str  # Name below the root of the survey
    folder: str  # Key of its pass or folder
    chunks: Callable[[], Iterable[PointCloud]]


@dataclass
class Recording:
    """The points of one pass in one file."""

    source: int  # Number of the file
    visit: int  # Number of the pass in the file
    starts: tuple[int, ...]  # First seconds of the later passes of the file, or the routes of points without time
    by_route: bool
    name: str
    pass_number: int = 0  # Recordings of one folder without a gap in time have one number
    cells: dict[int, int] = field(default_factory=dict)  # Key of a cell to the number of its points / STRIDE
    first: float = np.nan
    last: float = np.nan
    middle: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    @property
    def interval(self) -> tuple[float, float]:
        """Seconds from which and up to which the points of the file are of this pass."""
        if self.by_route or not self.starts:
            return -np.inf, np.inf
        edges = [-np.inf, *self.starts, np.inf]
        return edges[self.visit], edges[self.visit + 1]


class PairOffset(NamedTuple):
    """Offset of a recording from another one; `after` is what remains of it once recordings are moved."""

    fixed: int
    moving: int
    offset: Offset | None
    same: float  # share of the same points
    n_cells: int
    after: Offset | None = None


@dataclass(frozen=True)
class SurveyOffsets:
    """Recordings of a survey, the offsets of their pairs, and the moves that agree with them best."""

    recordings: tuple[Recording, ...] = ()
    pairs: tuple[PairOffset, ...] = ()
    moves: tuple[Move, ...] = ()
    left_out: int = 0  # Overlapping pairs that were not measured


NO_OFFSETS = SurveyOffsets()
"""Of a survey with a single file of one pass."""


def survey_offsets(sources: Sequence[Source]) -> SurveyOffsets:
    """Return the offsets between files and passes where they overlap."""
    recordings = [recording for number, source in enumerate(sources) for recording in _recordings(number, source)]
    common = _common_cells(recordings)
    chosen = dict(common.most_common(MOST_PAIRS))
    if not chosen:
        return SurveyOffsets(tuple(recordings))
    _number_passes(recordings, sources)
    cells = {pair: _spread(_shared(recordings, pair)) for pair in chosen}
    points = _points(sources, recordings, cells)
    pairs, surfaces = [], {}
    for (a, b), keys in cells.items():
        sides = [_in_cells(points[u], keys) for u in (a, b)]
        same = _same_share(*sides)
        offset = None
        if same < COPY:
            surfaces[a, b] = (find_surfaces(sides[0].xyz), find_surfaces(sides[1].xyz))
            offset = offset_of_surfaces(*surfaces[a, b])
        pairs.append(PairOffset(a, b, offset, same, chosen[a, b]))
    offsets = {(pair.fixed, pair.moving): pair.offset for pair in pairs if pair.offset is not None}
    origin = next(iter(points.values())).origin
    middles = np.array([recording.middle - origin for recording in recordings])
    local = adjust(middles, offsets, np.array([recording.pass_number for recording in recordings]))
    done = tuple(pair._replace(after=_remaining(pair, local, surfaces)) for pair in pairs)
    moves = tuple(Move(m.shift, m.heading, tuple((np.array(m.pivot) + origin).tolist())) for m in local)
    return SurveyOffsets(tuple(recordings), done, moves, len(common) - len(chosen))


def _remaining(
    pair: PairOffset, moves: Sequence[Move], surfaces: dict[tuple[int, int], tuple[Surfaces, Surfaces]]
) -> Offset | None:
    """Return the offset of a pair after its moves, measured anew."""
    key = pair.fixed, pair.moving
    if pair.offset is None or all(moves[u].is_small for u in key):
        return pair.offset
    placed = []
    for side, u in zip(surfaces[key], key, strict=True):
        move = moves[u]
        still = move.is_small
        placed.append(side if still else side.moved(np.array(move.shift), move.heading, np.array(move.pivot)))
    return offset_of_surfaces(*placed)


def _keys(xy: NDArray[np.float64]) -> NDArray[np.int64]:
    index = np.floor(np.nan_to_num(xy) / CELL).clip(-(2**30), 2**30).astype(np.int64)
    return (index[:, 0] << 32) + index[:, 1] + 2**31


def _visits(cloud: PointCloud, starts: Sequence[int], by_route: bool) -> NDArray[np.int64]:
    """Return the number of the pass of each point of a file."""
    if by_route:
        return np.searchsorted(np.array(starts), cloud[ROUTE])
    if not len(starts) or SECOND not in cloud:
        return np.zeros(len(cloud), dtype=np.int64)
    return np.searchsorted(np.array(starts), cloud[SECOND], side="right")


def _recordings(number: int, source: Source) -> Iterator[Recording]:
    """Return the recordings of a file with the cells that they cover."""
    thin, seconds, routes = [np.empty((0, 3))], [np.empty(0, np.int32)], [np.empty(0, np.int32)]
    for cloud in source.chunks():
        rows = np.arange(0, len(cloud), STRIDE)
        thin.append(cloud.xyz[rows].astype(np.float64) + cloud.origin)
        seconds.append(cloud[SECOND][rows] if SECOND in cloud else np.full(len(rows), NO_TIME, np.int32))
        routes.append(cloud[ROUTE][rows] if ROUTE in cloud else np.zeros(len(rows), np.int32))
    xyz, second, route = np.concatenate(thin), np.concatenate(seconds), np.concatenate(routes)
    known = np.unique(second[second != NO_TIME])
    by_route = not len(known) and len(np.unique(route)) > 1
    starts = np.unique(route) if by_route else known[1:][np.diff(known.astype(np.int64)) > int(PASS_GAP)]
    visits = np.searchsorted(starts, route) if by_route else np.searchsorted(starts, second, side="right")
    beside = np.array([[0.0, 0.0], [NEAR, 0.0], [-NEAR, 0.0], [0.0, NEAR], [0.0, -NEAR]])
    keys = np.array([_keys(xyz[:, :2] + each) for each in beside])
    n_visits = len(starts) + (not by_route)
    for visit in range(n_visits):
        own = visits == visit
        cells: Counter[int] = Counter()
        for moved in keys:  # a cell counts the points of the side that has most
            cells |= Counter(moved[own].tolist())
        times = second[own & (second != NO_TIME)]
        name = source.name if n_visits == 1 else f"{source.name} (pass {visit + 1})"
        yield Recording(
            *(number, visit, tuple(starts.tolist()), by_route, name),
            cells={key: count for key, count in cells.items() if count >= FEWEST_IN_CELL},
            first=float(times.min()) if len(times) else np.nan,
            last=float(times.max()) if len(times) else np.nan,
            middle=xyz[own].mean(axis=0) if own.any() else np.zeros(3),
        )


def _common_cells(recordings: Sequence[Recording]) -> Counter[tuple[int, int]]:
    """Return the number of common cells of each pair of recordings that has enough of them."""
    owners: dict[int, list[int]] = {}
    for number, recording in enumerate(recordings):
        for key in recording.cells:
            owners.setdefault(key, []).append(number)
    counts = Counter(pair for those in owners.values() if len(those) > 1 for pair in combinations(those, 2))
    return Counter({pair: count for pair, count in counts.items() if count >= FEWEST_CELLS})


def _number_passes(recordings: Sequence[Recording], sources: Sequence[Source]) -> None:
    """Give the recordings of one folder without a gap in time one number; those without time have their own."""
    ends: dict[str, tuple[float, int]] = {}
    for number, recording in enumerate(sorted(recordings, key=lambda each: np.nan_to_num(each.first, nan=-np.inf))):
        folder = sources[recording.source].folder
        last, current = ends.get(folder, (-np.inf, -1))
        together = recording.first - last <= PASS_GAP
        recording.pass_number = current if together else number
        ends[folder] = (max(last, recording.last) if together else recording.last, recording.pass_number)


def _shared(recordings: Sequence[Recording], pair: tuple[int, int]) -> list[int]:
    first, second = (recordings[u].cells for u in pair)
    return sorted(first.keys() & second.keys())


def _spread(keys: list[int]) -> NDArray[np.int64]:
    """Return at most `MOST_CELLS` cells at equal steps."""
    places = np.unique(np.linspace(0, len(keys) - 1, min(len(keys), MOST_CELLS)).round().astype(np.int64))
    return np.array(keys, dtype=np.int64)[places]


class _Points(NamedTuple):
    xyz: NDArray[np.float64]  # relative to `origin`
    key: NDArray[np.int64]
    digest: NDArray[np.int64]  # of coordinates and time
    origin: NDArray[np.float64]
    timed: bool


def _points(
    sources: Sequence[Source], recordings: Sequence[Recording], cells: dict[tuple[int, int], NDArray[np.int64]]
) -> dict[int, _Points]:
    """Return the points of the recordings in the cells of their pairs, thinned by their digest."""
    wanted: dict[int, NDArray[np.int64]] = {}
    for pair, keys in cells.items():
        for u in pair:
            wanted[u] = np.union1d(wanted.get(u, np.zeros(0, np.int64)), keys)
    largest = max(sum(recordings[u].cells.get(int(k), 0) for k in keys) for u, keys in wanted.items()) * STRIDE
    most = MOST_POINTS * max(1, max(len(keys) for keys in wanted.values()) // MOST_CELLS)
    step = max(1, round(largest / most))  # one for all recordings, so that copies keep the same points
    origin = np.floor(recordings[min(wanted)].middle)
    parts: dict[int, list[tuple[NDArray, NDArray, NDArray]]] = {u: [] for u in wanted}
    timed = dict.fromkeys(wanted, True)
    for number in sorted({recordings[u].source for u in wanted}):
        own = [u for u in wanted if recordings[u].source == number]
        for cloud in sources[number].chunks():
            world = cloud.xyz.astype(np.float64) + cloud.origin
            digest = _digests(world, cloud)
            rows = np.flatnonzero(digest % step == 0)
            keys = _keys(world[rows, :2])
            visits = _visits(cloud, recordings[own[0]].starts, recordings[own[0]].by_route)[rows]
            for u in own:
                chosen = np.flatnonzero((visits == recordings[u].visit) & _among(keys, wanted[u]))
                parts[u].append((world[rows[chosen]] - origin, keys[chosen], digest[rows[chosen]]))
                timed[u] &= SECOND in cloud
    joined = {u: [np.concatenate(each) for each in zip(*filled, strict=True)] for u, filled in parts.items()}
    return {u: _Points(xyz, key, digest, origin, timed[u]) for u, (xyz, key, digest) in joined.items()}


def _digests(world: NDArray[np.float64], cloud: PointCloud) -> NDArray[np.int64]:
    """Return a number per point that depends on its millimetres and its second."""
    x, y, z = np.rint(np.nan_to_num(world) * 1000).clip(-(2**62), 2**62).astype(np.int64).T
    mixed = x * 73856093 ^ y * 19349663 ^ z * 83492791
    if SECOND in cloud:
        mixed = mixed ^ (cloud[SECOND].astype(np.int64) * 49979687)
    return (mixed * 0x9E3779B97F4A7C1 >> 8) & 0x7FFFFFFFFFFF


def _among(values: NDArray[np.int64], ascending: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which values are among some few; `np.isin` sorts all of them."""
    found: NDArray[np.bool_] = ascending[np.searchsorted(ascending[:-1], values)] == values
    return found


def _in_cells(points: _Points, keys: NDArray[np.int64]) -> _Points:
    own = _among(points.key, keys)
    return points._replace(xyz=points.xyz[own], key=points.key[own], digest=points.digest[own])


def _same_share(first: _Points, second: _Points) -> float:
    """Return the share of the smaller recording's points that the other has too; 0 if chance explains it."""
    small, large = sorted((first.digest, second.digest), key=len)
    if not len(small):
        return 0.0
    share = float(np.isin(small, large).mean())
    return share if share >= (SAME_WITH_TIME if first.timed and second.timed else SAME_WITHOUT) else 0.0
