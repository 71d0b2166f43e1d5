"""Cutting a survey into scenes along its trajectory, without ever holding it.

A survey is read in ranges of rows. Each range is sorted into *bins* of the corridor (`cut_range`) and stored; from the
bins' counts the scenes are planned (`plan_scenes`); each scene is assembled from the slices of the ranges that it
covers (`assemble_scene`). The result does not depend on how the files were cut into ranges.
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
    """Points of a range of one file, sorted by the corridor's bins.

    Parameters
    ----------
    cloud : PointCloud
        The points, with the columns `row` (int64, index in the file) and `file` (int16, index of the file); within a
        bin in the file's order.
    bins : ndarray of int32, shape (b,)
        The occupied bins, ascending.
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
            The first bin, and the one after the last.

        Returns
        -------
        PiecedCloud
            Their points; none where the range has no point in them.
        """
        low, high = np.searchsorted(self.bins, [first, stop])
        rows = slice(self.indptr[low], self.indptr[high])
        columns = {name: values[rows] for name, values in self.cloud.columns.items()}
        cloud = replace(self.cloud, xyz=self.cloud.xyz[rows], columns=columns)
        return PiecedCloud(cloud, self.bins[low:high], self.indptr[low : high + 1] - self.indptr[low])

    def to_arrays(self) -> dict[str, NDArray]:
        """Return everything as named arrays, for an NPZ file."""
        text = {"crs": np.array(self.cloud.crs or ""), "source": np.array(self.cloud.source)}
        columns = {f"column.{name}": values for name, values in self.cloud.columns.items()}
        core = {"xyz": self.cloud.xyz, "origin": self.cloud.origin, "bins": self.bins, "indptr": self.indptr}
        return {**core, **columns, **text}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> PiecedCloud:
        """Build the pieces from what `to_arrays` gave; `arrays` may be an open NPZ file."""
        columns = {name.removeprefix("column."): arrays[name] for name in arrays if name.startswith("column.")}
        crs = str(arrays["crs"]) or None
        cloud = PointCloud(arrays["xyz"], columns, arrays["origin"], crs, str(arrays["source"]))
        return cls(cloud, arrays["bins"], arrays["indptr"])


def cut_range(
    cloud: PointCloud, corridor: Corridor, *, bin_length: float, first_row: int, file: int = 0
) -> PiecedCloud:
    """Sort a range of a file's points stably into the corridor's bins.

    Parameters
    ----------
    cloud : PointCloud
        Consecutive points of one file.
    corridor : Trajectory, MainAxis or None
        What the survey is cut along; None puts every point into the bin with the file's number.
    bin_length : float
        Length of a bin along the corridor, metres; bin b holds stations from b to b + 1 times this. Smaller bins let
        scenes follow dense places more closely and cost a table entry each; 1 to 5 m suit streets. Without a corridor
        it is not used.
    first_row : int
        Index of the first point in its file.
    file : int, default 0
        Index of the file in the sorted list of the survey's files.

    Returns
    -------
    PiecedCloud
        All points, with the columns `row` and `file` added.

    Raises
    ------
    DataError
        If the cloud has a column `row`, `file` or `core` already, or NaN or infinite coordinates.
    ParameterError
        If `bin_length` is not above zero, `first_row` is negative, or `file` is outside 0 to 32767.
    """
    check_positive(bin_length, "bin_length")
    if first_row < 0:
        raise ParameterError(f"first_row must not be negative, got {first_row}")
    if not 0 <= file <= np.iinfo(np.int16).max:
        raise ParameterError(f"file must be in 0..32767 (the files of one survey), got {file}")
    for name in ("row", "file", "core"):
        if name in cloud:
            raise DataError(f"{cloud.source} has a column {name!r}: the name is reserved for scenes")
    if corridor is None:
        numbers = np.full(len(cloud), file, dtype=np.int32)
    else:
        station, _ = corridor.locate(cloud.xyz, origin=cloud.origin)
        numbers = np.floor(station / bin_length).astype(np.int32)
    relative = numbers - (numbers.min() if len(numbers) else 0)
    if relative.max(initial=0) < np.iinfo(np.int16).max:
        relative = relative.astype(np.int16)  # 16-bit keys: NumPy sorts them by radix, in linear time
    order = np.argsort(relative, kind="stable")
    bins, starts = np.unique(numbers[order], return_index=True)
    row = np.arange(first_row, first_row + len(cloud), dtype=np.int64)
    number = np.full(len(cloud), file, dtype=np.int16)
    indptr = np.append(starts, len(cloud)).astype(np.int64)
    return PiecedCloud(cloud.with_columns(row=row, file=number).select(order), bins, indptr)


@dataclass(frozen=True)
class SceneSpan:
    """The bins of one scene, as half-open ranges.

    Parameters
    ----------
    id : str
        The scene's name, such as ``"scene_00012"``, in the order of the corridor.
    first, stop : int
        Bins of the core.
    buffer_first, buffer_stop : int
        Bins of the core and its buffers.
    n_core, n_points : int
        Points in the core, and in core and buffers.
    """

    id: str
    first: int
    stop: int
    buffer_first: int
    buffer_stop: int
    n_core: int
    n_points: int


def _cores(bins: Sequence[int], count: Mapping[int, int], n_bins: int, max_points: int) -> list[tuple[int, int]]:
    """Cut ascending bins greedily into half-open cores of at most n_bins bins and max_points points."""
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
    histogram: Mapping[int, int], *, scene_length: float, buffer: float, bin_length: float, max_points: int
) -> list[SceneSpan]:
    """Cut a corridor into scenes of consecutive bins.

    A core begins at the first bin that no core has yet and grows until it is `scene_length` long or the next bin would
    bring it above `max_points`; a bin that alone has more is a scene of its own. Empty stretches between cores belong
    to no scene. The last core of a stretch without gaps joins the one before it where it is shorter than a quarter of
    `scene_length` and both together stay within `max_points`.

    Parameters
    ----------
    histogram : mapping of int to int
        Points per bin, summed over all ranges; bins without points may be left out.
    scene_length : float
        Length of a core, metres. Larger scenes read fewer buffer points twice and take more memory; 20 to 100 m.
    buffer : float
        Context on both sides of the core, metres, rounded up to whole bins: what neighbourhoods need and, so
        that objects are seen whole, the length of most objects; 5 to 10 m.
    bin_length : float
        The bins' length, metres, as in `cut_range`.
    max_points : int
        The most points of a core, where bins allow: with the buffers it bounds the memory of a scene.

    Returns
    -------
    list of SceneSpan
        In the order of the corridor; every bin with points is in exactly one core.

    Raises
    ------
    ParameterError
        If a length is not above zero, `buffer` is negative or not finite, or `max_points` is below 1.
    """
    check_positive(scene_length, "scene_length")
    check_positive(bin_length, "bin_length")
    if not np.isfinite(buffer) or buffer < 0:
        raise ParameterError(f"buffer must be a finite number >= 0, got {buffer!r}")
    check_at_least(max_points, 1, "max_points")
    count = {number: n for number, n in sorted(histogram.items()) if n > 0}
    n_bins = max(1, round(scene_length / bin_length))
    margin = int(np.ceil(buffer / bin_length - 1e-9))
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
    return [
        SceneSpan(f"scene_{i:05d}", a, b, a - margin, b + margin, between(a, b), between(a - margin, b + margin))
        for i, (a, b) in enumerate(cores)
    ]


def assemble_scene(pieces: Sequence[PiecedCloud], span: SceneSpan) -> PointCloud:
    """Join the slices of a survey's ranges that a scene covers.

    Parameters
    ----------
    pieces : sequence of PiecedCloud
        Ranges that hold the scene's bins, whole or cut to them, in any order.
    span : SceneSpan
        The scene's bins.

    Returns
    -------
    PointCloud
        The points of core and buffers, ordered by (file, row), with the bool column `core`; relative to the origin
        of the first of them. Columns that only some files have are left out.

    Raises
    ------
    DataError
        If no piece has a point in the scene, a point arrives twice, or files have different coordinate systems.
    """
    parts, cores = [], []
    for piece in pieces:
        part = piece.between(span.buffer_first, span.buffer_stop)
        if len(part) > 0:
            parts.append(part.cloud)
            inside = (part.bins >= span.first) & (part.bins < span.stop)
            cores.append(np.repeat(inside, np.diff(part.indptr)))
    if not parts:
        raise DataError(f"{span.id}: none of {len(pieces)} pieces has points in bins {span.first} to {span.stop - 1}")
    # The origin and the column order come from the first piece: that must not depend on the order of arrival.
    rank = sorted(range(len(parts)), key=lambda i: (int(parts[i]["file"][0]), int(parts[i]["row"].min())))
    scene = concatenate([parts[i] for i in rank])
    scene = scene.with_columns(core=np.concatenate([cores[i] for i in rank]))
    order = np.lexsort((scene["row"], scene["file"]))
    file, row = scene["file"][order], scene["row"][order]
    twice = np.flatnonzero((np.diff(file) == 0) & (np.diff(row) == 0))
    if len(twice):
        raise DataError(f"{span.id}: row {row[twice[0]]} of file {file[twice[0]]} arrived twice")
    return replace(scene.select(order), source=span.id)
