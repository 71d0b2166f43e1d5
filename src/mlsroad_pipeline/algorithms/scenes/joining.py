"""Scenes as ranges of bins along the survey, and their joining from slices of ranges of rows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud, concatenate
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive
from mlsroad_pipeline.algorithms.geometry.outliers import keep_inliers
from mlsroad_pipeline.algorithms.geometry.sorting import order_of
from mlsroad_pipeline.algorithms.scenes.binning import BinnedCloud
from mlsroad_pipeline.algorithms.scenes.parameters import OutlierParameters

CONTEXT_POINTS = 100_000
"""Points of the context that are never thinned."""


@dataclass(frozen=True)
class SceneSpan:
    """Bins of one scene, as half-open ranges."""

    id: str  # Name of the scene, such as ``"scene_00012"``, numbered along the corridor
    # first, stop: bins of the core
    first: int
    stop: int
    # buffer_first, buffer_stop: bins of the core and its buffers
    buffer_first: int
    buffer_stop: int
    # n_core, n_points: number of points in the core, and in core and buffers
    n_core: int
    n_points: int
    context: int = 0  # Bins of further context on both sides of the buffers
    context_step: int = 1  # One of so many points of the context is taken

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
    `max_points`; a single bin above `max_points` is a scene of its own.
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
        context_step = max(-(-n_outer // max(n_core // 4, CONTEXT_POINTS)), 1)
        spans.append(SceneSpan(f"scene_{i:05d}", a, b, a - margin, b + margin, n_core, n_points, outer, context_step))
    return spans


def join_pieces(
    pieces: Sequence[Mapping[str, NDArray]], span: SceneSpan, outliers: OutlierParameters, source: str
) -> PointCloud:
    """Join a scene from stored pieces."""
    parts = [BinnedCloud.from_arrays(piece).between(*span.reach) for piece in pieces]
    filled = [part for part in parts if len(part)]
    corner = np.floor(np.min([_lowest(part.cloud.xyz) + part.cloud.origin for part in filled], axis=0))
    single = [_single_precision(part, corner) for part in filled]
    crs = single[0].cloud.crs  # one system, whose spelling may differ between files
    joined = assemble_scene([replace(part, cloud=replace(part.cloud, crs=crs)) for part in single], span)
    scene = replace(joined, source=source)
    if outliers.enabled:
        inlier = keep_inliers(scene.xyz, n_neighbors=outliers.k, std_ratio=outliers.ratio)
        scene = scene.with_columns(outlier=~inlier)
    return scene


def _lowest(xyz: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the least coordinates; columns one by one are twenty times as fast as ``min(axis=0)``."""
    return np.array([xyz[:, axis].min() for axis in range(3)])


def _single_precision(piece: BinnedCloud, origin: NDArray[np.float64]) -> BinnedCloud:
    """Return points in float32, relative to another origin."""
    xyz = np.empty(piece.cloud.xyz.shape, dtype=np.float32)
    for axis in range(3):
        xyz[:, axis] = piece.cloud.xyz[:, axis] + (piece.cloud.origin[axis] - origin[axis])
    return replace(piece, cloud=replace(piece.cloud, xyz=xyz, origin=origin))


def assemble_scene(pieces: Sequence[BinnedCloud], span: SceneSpan) -> PointCloud:
    """Join a scene from ranges of rows."""
    parts, rows, cores, nears = [], [], [], []
    for piece in pieces:
        part = piece.between(*span.reach)
        kept, core, near = _within(part, span)
        if len(kept) > 0:
            parts.append(part.cloud)
            rows.append(kept)
            cores.append(core)
            nears.append(near)
    if not parts:
        raise DataError(f"{span.id}: none of {len(pieces)} pieces has points in bins {span.first} to {span.stop - 1}")
    # Origin and column order are those of the first piece, so pieces are sorted first.
    rank = sorted(range(len(parts)), key=lambda i: (int(parts[i]["file"][0]), int(parts[i]["row"][rows[i][0]])))
    scene = concatenate([parts[i] for i in rank], [rows[i] for i in rank])
    scene = scene.with_columns(core=np.concatenate([cores[i] for i in rank]))
    if span.context:
        scene = scene.with_columns(near=np.concatenate([nears[i] for i in rank]))
    low = int(scene["row"].min())
    n_rows = int(scene["row"].max()) + 1 - low
    numbers = scene["file"].astype(np.int64) * n_rows + (scene["row"] - low)
    if (numbers[1:] > numbers[:-1]).all():  # pieces of one file follow each other
        return replace(scene, source=span.id)
    keys, order = order_of(numbers)
    twice = np.flatnonzero(keys[1:] == keys[:-1])
    if len(twice):
        file, row = divmod(int(keys[twice[0]]), n_rows)
        raise DataError(f"{span.id}: row {row + low} of file {file} occurs in two pieces")
    return replace(scene.select(order), source=span.id)


def _within(part: BinnedCloud, span: SceneSpan) -> tuple[NDArray[np.integer], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the points of a scene in a range of rows, and which of them are in the core, and in core and buffers.

    They are in the order of their rows: sorted here, points are copied once, and within a part of the memory.
    """
    count = np.diff(part.indptr)
    core = np.repeat((part.bins >= span.first) & (part.bins < span.stop), count)
    near = np.repeat((part.bins >= span.buffer_first) & (part.bins < span.buffer_stop), count)
    row = part.cloud["row"]
    if span.context_step == 1:
        kept: NDArray[np.integer] = order_of(row)[1]
    else:  # a hash of the row: every n-th row may be of one beam of the scanner
        mixed = row.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        kept = np.flatnonzero(near | ((mixed >> np.uint64(33)) % np.uint64(span.context_step) == 0))
        kept = kept[order_of(row[kept])[1]]
    return kept, core[kept], near[kept]
