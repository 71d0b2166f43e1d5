"""Cutting of a survey into scenes along its trajectory in bounded memory.

A survey is read in ranges of rows. `cut_range` sorts each range into *bins* of the corridor, `plan_scenes` plans the
scenes from the counts of the bins, and `assemble_scene` joins each scene from slices of the ranges. The result does not
depend on the size of the ranges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud, concatenate
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive
from mlsroad_pipeline.algorithms.scenes.corridor import Corridor


@dataclass(frozen=True)
class PiecedCloud:
    """Points of a range of one file, sorted by bins of the corridor.

    Parameters
    ----------
    cloud : PointCloud
        The points, with the columns `row` (int64, index in the file) and `file` (int16, index of the file); in file
        order within a bin.
    bins : ndarray of int32, shape (b,)
        Occupied bins, ascending.
    indptr : ndarray of int64, shape (b + 1,)
        Points of bin ``bins[i]`` are rows ``indptr[i]`` to ``indptr[i + 1]`` of `cloud`.
    """

    cloud: PointCloud
    bins: NDArray[np.int32]
    indptr: NDArray[np.int64]

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.cloud)

    def histogram(self) -> dict[int, int]:
        """Return the number of points per occupied bin."""
        return dict(zip(self.bins.tolist(), np.diff(self.indptr).tolist(), strict=True))

    def between(self, first: int, stop: int) -> PiecedCloud:
        """Return the points of some bins, as views.

        Parameters
        ----------
        first, stop : int
            First bin, and the bin after the last.

        Returns
        -------
        PiecedCloud
            Their points, possibly none.
        """
        low, high = np.searchsorted(self.bins, [first, stop])
        rows = slice(self.indptr[low], self.indptr[high])
        columns = {name: values[rows] for name, values in self.cloud.columns.items()}
        cloud = replace(self.cloud, xyz=self.cloud.xyz[rows], columns=columns)
        return PiecedCloud(cloud, self.bins[low:high], self.indptr[low : high + 1] - self.indptr[low])

    def to_arrays(self) -> dict[str, NDArray]:
        """Return named arrays for an NPZ file."""
        text = {"crs": np.array(self.cloud.crs or ""), "source": np.array(self.cloud.source)}
        columns = {f"column.{name}": values for name, values in self.cloud.columns.items()}
        core = {"xyz": self.cloud.xyz, "origin": self.cloud.origin, "bins": self.bins, "indptr": self.indptr}
        return {**core, **columns, **text}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> PiecedCloud:
        """Return the points of arrays of `to_arrays`, or of an open NPZ file."""
        columns = {name.removeprefix("column."): arrays[name] for name in arrays if name.startswith("column.")}
        crs = str(arrays["crs"]) or None
        cloud = PointCloud(arrays["xyz"], columns, arrays["origin"], crs, str(arrays["source"]))
        return cls(cloud, arrays["bins"], arrays["indptr"])


def cut_range(
    cloud: PointCloud, corridor: Corridor, *, bin_length: float, first_row: int, file: int = 0
) -> PiecedCloud:
    """Sort a range of rows of a file into bins of the corridor, stably.

    Parameters
    ----------
    cloud : PointCloud
        Consecutive points of one file.
    corridor : Trajectory, MainAxis or None
        Corridor of the survey; None assigns all points to the bin with the number of the file.
    bin_length : float
        Length of a bin along the corridor, metres; bin b holds the stations from b to b + 1 times this length. Smaller
        bins adapt scenes more closely to dense places and cost a table entry each; 1 to 5 m for streets. Unused without
        a corridor.
    first_row : int
        Index of the first point in its file.
    file : int, default 0
        Index of the file in the sorted list of files.

    Returns
    -------
    PiecedCloud
        All points, with the columns `row` and `file` added.

    Raises
    ------
    DataError
        If the cloud has a column `row`, `file`, `core` or `near`, or NaN or infinite coordinates.
    ParameterError
        If `bin_length` is not above zero, `first_row` is negative, or `file` is outside 0 to 32767.
    """
    check_positive(bin_length, "bin_length")
    if first_row < 0:
        raise ParameterError(f"first_row must not be negative, got {first_row}")
    if not 0 <= file <= np.iinfo(np.int16).max:
        raise ParameterError(f"file must be in 0..32767 (the files of one survey), got {file}")
    for name in ("row", "file", "core", "near"):
        if name in cloud:
            raise DataError(f"{cloud.source} has a column {name!r}, a name reserved for scenes: rename it")
    if corridor is None:
        numbers = np.full(len(cloud), file, dtype=np.int32)
    else:
        station, _ = corridor.locate(cloud.xyz, origin=cloud.origin)
        numbers = np.floor(station / bin_length).astype(np.int32)
    relative = numbers - (numbers.min() if len(numbers) else 0)
    if relative.max(initial=0) < np.iinfo(np.int16).max:
        relative = relative.astype(np.int16)  # NumPy sorts 16-bit keys by radix sort, in linear time
    order = np.argsort(relative, kind="stable")
    bins, starts = np.unique(numbers[order], return_index=True)
    row = np.arange(first_row, first_row + len(cloud), dtype=np.int64)
    number = np.full(len(cloud), file, dtype=np.int16)
    indptr = np.append(starts, len(cloud)).astype(np.int64)
    return PiecedCloud(cloud.with_columns(row=row, file=number).select(order), bins, indptr)


CONTEXT_POINTS = 100_000
"""Points of the context that are never thinned."""


@dataclass(frozen=True)
class SceneSpan:
    """Bins of one scene, as half-open ranges.

    Parameters
    ----------
    id : str
        Name of the scene, such as ``"scene_00012"``, numbered along the corridor.
    first, stop : int
        Bins of the core.
    buffer_first, buffer_stop : int
        Bins of the core and its buffers.
    n_core, n_points : int
        Number of points in the core, and in core and buffers.
    context : int, default 0
        Bins of further context on both sides of the buffers.
    step : int, default 1
        One of so many points of the context is taken.
    """

    id: str
    first: int
    stop: int
    buffer_first: int
    buffer_stop: int
    n_core: int
    n_points: int
    context: int = 0
    step: int = 1

    @property
    def reach(self) -> tuple[int, int]:
        """Return the bins of core, buffers and context."""
        return self.buffer_first - self.context, self.buffer_stop + self.context


def _cores(bins: Sequence[int], count: Mapping[int, int], n_bins: int, max_points: int) -> list[tuple[int, int]]:
    """Divide ascending bins greedily into half-open cores of at most `n_bins` bins and `max_points` points."""
    cores: list[tuple[int, int]] = []
    points = 0
    for number in bins:
        if cores and number < cores[-1][0] + n_bins and points + count[number] <= max_points:
            cores[-1] = (cores[-1][0], number + 1)
            points += count[number]
        else:
            cores.append((number, number + 1))
            points = count[number]
    return cores


def plan_scenes(
    histogram: Mapping[int, int],
    *,
    scene_length: float,
    buffer: float,
    bin_length: float,
    max_points: int,
    context: float = 0.0,
) -> list[SceneSpan]:
    """Divide a corridor into scenes of consecutive bins.

    A core starts at the first bin without a core and grows until it is `scene_length` long or the next bin would exceed
    `max_points`; a single bin above `max_points` is a scene of its own. Empty stretches between cores belong to no
    scene. The last core of a stretch without gaps is merged with the previous one if it is shorter than a quarter of
    `scene_length` and both together have at most `max_points`.

    Parameters
    ----------
    histogram : mapping of int to int
        Points per bin, summed over all ranges; empty bins may be omitted.
    scene_length : float
        Length of a core, metres. Longer scenes read fewer buffer points twice and take more memory; 20 to 100 m.
    buffer : float
        Context on both sides of the core, metres, rounded up to whole bins: at least the radius of neighbourhoods and
        the length of most objects; 5 to 10 m.
    bin_length : float
        Length of a bin, metres, as in `cut_range`.
    max_points : int
        Largest number of points of a core with several bins; with the buffers it bounds the memory of a scene.
    context : float, default 0.0
        Further context on both sides of the buffers, metres, rounded up to whole bins. Where it has more than a quarter
        of the points of the core, and more than 100,000, it is thinned. Larger costs time and memory.

    Returns
    -------
    list of SceneSpan
        Scenes in the order of the corridor; each bin with points is in exactly one core.

    Raises
    ------
    ParameterError
        If a length is not above zero, `buffer` or `context` is negative or not finite, or `max_points` is below 1.
    """
    check_positive(scene_length, "scene_length")
    check_positive(bin_length, "bin_length")
    for name, length in (("buffer", buffer), ("context", context)):
        if not np.isfinite(length) or length < 0:
            raise ParameterError(f"{name} must be a finite number >= 0, got {length!r}")
    check_at_least(max_points, 1, "max_points")
    count = {number: n for number, n in sorted(histogram.items()) if n > 0}
    n_bins = max(1, round(scene_length / bin_length))
    margin, outer = (int(np.ceil(length / bin_length - 1e-9)) for length in (buffer, context))
    bins = np.array(list(count), dtype=np.int64)
    total = np.concatenate([[0], np.cumsum(list(count.values()))]).astype(np.int64)

    def between(first: int, stop: int) -> int:
        low, high = np.searchsorted(bins, [first, stop])
        return int(total[high] - total[low])

    cores: list[tuple[int, int]] = []
    greedy = _cores(list(count), count, n_bins, max_points)
    for i, (first, stop) in enumerate(greedy):
        ends_stretch = i + 1 == len(greedy) or greedy[i + 1][0] > stop
        short = bool(cores) and cores[-1][1] == first and 4 * (stop - first) < n_bins
        if ends_stretch and short and between(cores[-1][0], stop) <= max_points:
            cores[-1] = (cores[-1][0], stop)
        else:
            cores.append((first, stop))
    spans = []
    for i, (a, b) in enumerate(cores):
        n_core, n_points = between(a, b), between(a - margin, b + margin)
        n_outer = between(a - margin - outer, b + margin + outer) - n_points
        step = max(-(-n_outer // max(n_core // 4, CONTEXT_POINTS)), 1)
        spans.append(SceneSpan(f"scene_{i:05d}", a, b, a - margin, b + margin, n_core, n_points, outer, step))
    return spans


def assemble_scene(pieces: Sequence[PiecedCloud], span: SceneSpan) -> PointCloud:
    """Join a scene from ranges of rows.

    Parameters
    ----------
    pieces : sequence of PiecedCloud
        Ranges with bins of the scene, in any order.
    span : SceneSpan
        Bins of the scene.

    Returns
    -------
    PointCloud
        Points of core, buffers and context, ordered by (file, row), with the bool column `core` and, with a context,
        `near` (core and buffers), relative to the origin of the first piece. Columns that some files lack are left out.

    Raises
    ------
    DataError
        If no piece has a point in the scene, a point occurs twice, or files have different coordinate systems.
    """
    parts, cores, nears = [], [], []
    for piece in pieces:
        cloud, core, near = _within(piece.between(*span.reach), span)
        if len(cloud) > 0:
            parts.append(cloud)
            cores.append(core)
            nears.append(near)
    if not parts:
        raise DataError(f"{span.id}: none of {len(pieces)} pieces has points in bins {span.first} to {span.stop - 1}")
    # Origin and column order are those of the first piece, so pieces are sorted first.
    rank = sorted(range(len(parts)), key=lambda i: (int(parts[i]["file"][0]), int(parts[i]["row"].min())))
    scene = concatenate([parts[i] for i in rank])
    scene = scene.with_columns(core=np.concatenate([cores[i] for i in rank]))
    if span.context:
        scene = scene.with_columns(near=np.concatenate([nears[i] for i in rank]))
    order = np.lexsort((scene["row"], scene["file"]))
    file, row = scene["file"][order], scene["row"][order]
    twice = np.flatnonzero((np.diff(file) == 0) & (np.diff(row) == 0))
    if len(twice):
        raise DataError(f"{span.id}: row {row[twice[0]]} of file {file[twice[0]]} occurs in two pieces")
    return replace(scene.select(order), source=span.id)


def _within(part: PiecedCloud, span: SceneSpan) -> tuple[PointCloud, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the points of a scene in a range of rows, and which of them are in the core, and in core and buffers."""
    count = np.diff(part.indptr)
    core = np.repeat((part.bins >= span.first) & (part.bins < span.stop), count)
    near = np.repeat((part.bins >= span.buffer_first) & (part.bins < span.buffer_stop), count)
    if span.step == 1:
        return part.cloud, core, near
    # A hash of the row: every n-th row may be of one beam of the scanner.
    row = part.cloud["row"].astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    kept = np.flatnonzero(near | ((row >> np.uint64(33)) % np.uint64(span.step) == 0))
    return part.cloud.select(kept), core[kept], near[kept]
