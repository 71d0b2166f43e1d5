"""Quality of a file, collected chunk by chunk in bounded memory."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypedDict

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY_NAMES
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.quality.density import cell_positions, count_places, density_figures
from mlsroad_pipeline.algorithms.quality.duplicates import (
    DuplicateSketch,
    count_duplicates,
    hash_points,
    merge_sketches,
    sketch_of,
)
from mlsroad_pipeline.algorithms.quality.report import STANDARD_COLUMNS, QualityReport

__all__ = ["STANDARD_COLUMNS", "ChunkQuality", "QualityReport", "TimeQuality", "inspect_chunk", "merge"]

LATEST = 1e11
"""Seconds; larger numbers are no times and count as infinite."""

DENSITY_CELL = 1.0
"""Side of the cells of the density, metres."""


_INT64_RANGE = 2.0**63


class TimeRow(TypedDict):
    """Fields of a report that are computed from times."""

    time_start: float
    time_end: float
    n_gaps: int
    longest_gap: float
    n_backward: int


@dataclass(frozen=True)
class TimeQuality:
    """Times of a chunk, for the gaps and the order."""

    bins: NDArray[np.int64]  # Occupied bins of `gap` seconds, ascending
    # First and last time in each bin. A gap longer than a bin lies between consecutive occupied bins.
    earliest: NDArray[np.float64]
    latest: NDArray[np.float64]
    # first, last: times of the first and the last stored point
    first: float
    last: float
    n_backward: int  # Number of stored points with a smaller time than their predecessor


@dataclass(frozen=True)
class ChunkQuality:
    """Contribution of a chunk to the report of its file; `merge` joins them."""

    source: str  # The file
    # Numbers of points, of points with a NaN or infinite coordinate, of exact duplicates within the chunk, of points
    # flagged withheld, of others with a code of noise
    n_points: int
    n_not_finite: int
    n_duplicates: int
    n_withheld: int
    n_noise: int
    # low, high: world extent of the finite points, metres; infinite without finite points
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    # cells, cell_counts: keys of the occupied cells of 1 m, and their numbers of points
    cells: NDArray[np.int64]
    cell_counts: NDArray[np.int64]
    sketch: DuplicateSketch  # Sample of the points, for duplicates across chunks
    columns: frozenset[str]  # Column names
    classes: dict[int, int]  # Number of points per label code; empty without labels
    time: TimeQuality | None  # Times; None without `gps_time` or finite times
    n_times_not_finite: int  # Number of NaN or infinite times
    intensity: tuple[float, float] | None  # Smallest and largest finite intensity
    max_gap: float  # Largest step in time that is not a gap, seconds


def inspect_chunk(
    cloud: PointCloud, *, max_gap: float = 1.0, n_total: int | None = None, noise: NDArray[np.bool_] | None = None
) -> ChunkQuality:
    """Inspect one chunk of a file, which may have NaN coordinates; `noise` marks points with a code of noise."""
    check_positive(max_gap, "max_gap")
    world = cloud.world_xyz()
    with np.errstate(over="ignore"):
        total = world.sum()
    if not np.isfinite(total):  # one pass in the usual case of finite coordinates
        world = world[np.isfinite(world).all(axis=1)]
    hashes = hash_points(world)
    cells, cell_counts = _occupied_cells(world)
    time, n_times_not_finite = _inspect_time(cloud.get("gps_time"), max_gap)
    withheld = cloud["withheld"] if "withheld" in cloud else np.zeros(len(cloud), np.bool_)
    return ChunkQuality(
        source=cloud.source,
        n_points=len(cloud),
        n_not_finite=len(cloud) - len(world),
        n_duplicates=count_duplicates(world, hashes),
        n_withheld=int(np.count_nonzero(withheld)),
        n_noise=0 if noise is None else int(np.count_nonzero(noise & (withheld == 0))),
        low=np.array([axis.min(initial=np.inf) for axis in world.T]),
        high=np.array([axis.max(initial=-np.inf) for axis in world.T]),
        cells=cells,
        cell_counts=cell_counts,
        sketch=sketch_of(hashes, n_total=n_total),
        columns=frozenset(cloud.columns),
        classes=_count_codes(cloud.get("label")),
        time=time,
        n_times_not_finite=n_times_not_finite,
        intensity=_finite_range(cloud.get("intensity")),
        max_gap=max_gap,
    )


def _occupied_cells(world: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return sorted keys of the occupied cells, and their numbers of points; runs of equal keys are sorted as one."""
    return _sum_by_cell(*_runs_of_cells(world))


@njit(cache=True, nogil=True)
def _cell(value: float) -> np.int64:
    """Return the cell of a coordinate; damaged files have some outside the range of int64."""
    scaled = np.floor(value / DENSITY_CELL)
    return np.int64(scaled) if -_INT64_RANGE <= scaled < _INT64_RANGE else np.int64(-_INT64_RANGE)


@njit(cache=True, nogil=True)
def _runs_of_cells(world: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the key of the cell of each run of successive points in one cell, and their number."""
    keys, counts = np.empty(len(world), np.int64), np.zeros(len(world), np.int64)
    n = 0
    for i in range(len(world)):
        key = (_cell(world[i, 0]) << 32) + _cell(world[i, 1])
        if n == 0 or key != keys[n - 1]:
            keys[n] = key
            n += 1
        counts[n - 1] += 1
    return keys[:n].copy(), counts[:n].copy()


def _sum_by_cell(keys: NDArray[np.int64], counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the distinct keys, ascending, and the sum of the counts of each."""
    distinct, inverse = np.unique(keys, return_inverse=True)
    return distinct, np.bincount(inverse, weights=counts, minlength=len(distinct)).astype(np.int64)


def _count_codes(labels: NDArray | None) -> dict[int, int]:
    if labels is None:
        return {}
    if labels.dtype == np.uint8:  # taxonomy codes: counted without sorting
        counts = np.bincount(labels, minlength=1)
        return {int(code): int(counts[code]) for code in np.flatnonzero(counts)}
    codes, counts = np.unique(labels, return_counts=True)
    return {int(code): int(count) for code, count in zip(codes, counts, strict=True)}


def _finite_range(values: NDArray | None) -> tuple[float, float] | None:
    if values is None:
        return None
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if len(finite) else None


def _inspect_time(times: NDArray | None, max_gap: float) -> tuple[TimeQuality | None, int]:
    if times is None:
        return None, 0
    finite = times[np.abs(times) < LATEST].astype(np.float64)
    if len(finite) == 0:
        return None, len(times)
    bins = np.floor(finite / max_gap).astype(np.int64)
    starts = np.flatnonzero(np.diff(bins, prepend=bins[0] - 1))  # runs within a bin; few if times ascend
    earliest, latest = np.minimum.reduceat(finite, starts), np.maximum.reduceat(finite, starts)
    n_backward = int(np.count_nonzero(np.diff(finite) < 0))
    time = TimeQuality(*_join_bins(bins[starts], earliest, latest), float(finite[0]), float(finite[-1]), n_backward)
    return time, len(times) - len(finite)


def merge(chunks: Sequence[ChunkQuality]) -> QualityReport:
    """Join the chunks of a file into its report."""
    if not chunks:
        raise DataError("no chunks to merge")
    first = chunks[0]
    if any(chunk.max_gap != first.max_gap for chunk in chunks):
        raise DataError(f"{first.source}: chunks inspected with different max_gap: {[c.max_gap for c in chunks]}")
    n_points = sum(chunk.n_points for chunk in chunks)
    n_not_finite = sum(chunk.n_not_finite for chunk in chunks)
    has_extent = n_points > n_not_finite
    cells, counts = _sum_by_cell(
        np.concatenate([chunk.cells for chunk in chunks]), np.concatenate([chunk.cell_counts for chunk in chunks])
    )
    low = np.min([chunk.low for chunk in chunks], axis=0) if has_extent else np.full(3, np.nan)
    high = np.max([chunk.high for chunk in chunks], axis=0) if has_extent else np.full(3, np.nan)
    columns = frozenset.intersection(*(chunk.columns for chunk in chunks))
    n_duplicates, duplicates_exact = _merge_duplicates(chunks)
    ranges = [chunk.intensity for chunk in chunks if chunk.intensity is not None]
    return QualityReport(
        source=first.source,
        n_points=n_points,
        n_not_finite=n_not_finite,
        n_duplicates=n_duplicates,
        duplicates_exact=duplicates_exact,
        n_withheld=sum(chunk.n_withheld for chunk in chunks),
        n_noise=sum(chunk.n_noise for chunk in chunks),
        n_places=count_places(cell_positions(cells, DENSITY_CELL)),
        low=tuple(low.tolist()),
        high=tuple(high.tolist()),
        **density_figures(cells, counts, DENSITY_CELL)._asdict(),
        present=tuple(name for name in STANDARD_COLUMNS if name in columns),
        missing=tuple(name for name in STANDARD_COLUMNS if name not in columns),
        classes=_merge_classes(chunks),
        **_merge_times([chunk.time for chunk in chunks if chunk.time is not None], first.max_gap),
        n_times_not_finite=sum(chunk.n_times_not_finite for chunk in chunks),
        intensity_min=min((r[0] for r in ranges), default=float("nan")),
        intensity_max=max((r[1] for r in ranges), default=float("nan")),
        max_gap=first.max_gap,
    )


def _join_bins(
    bins: NDArray[np.int64], earliest: NDArray[np.float64], latest: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the distinct bins, ascending, with the first and the last time in each."""
    distinct, inverse = np.unique(bins, return_inverse=True)
    first, last = np.full(len(distinct), np.inf), np.full(len(distinct), -np.inf)
    np.minimum.at(first, inverse, earliest)
    np.maximum.at(last, inverse, latest)
    return distinct, first, last


def _merge_duplicates(chunks: Sequence[ChunkQuality]) -> tuple[int, bool]:
    within = sum(chunk.n_duplicates for chunk in chunks)
    if len(chunks) == 1:
        return within, True
    sketch = merge_sketches([chunk.sketch for chunk in chunks])
    return max(within, sketch.n_duplicates()), sketch.complete


def _merge_classes(chunks: Sequence[ChunkQuality]) -> dict[str, int]:
    codes = sorted({code for chunk in chunks for code in chunk.classes})
    names = {code: TAXONOMY_NAMES.get(code, f"unknown_{code}") for code in codes}
    return {names[code]: sum(chunk.classes.get(code, 0) for chunk in chunks) for code in codes}


def _merge_times(times: Sequence[TimeQuality], max_gap: float) -> TimeRow:
    if not times:
        nan = float("nan")
        return TimeRow(time_start=nan, time_end=nan, n_gaps=0, longest_gap=nan, n_backward=0)
    _, earliest, latest = _join_bins(
        np.concatenate([t.bins for t in times]),
        np.concatenate([t.earliest for t in times]),
        np.concatenate([t.latest for t in times]),
    )
    steps = earliest[1:] - latest[:-1]
    gaps = steps[steps > max_gap]
    return TimeRow(
        time_start=float(earliest[0]),
        time_end=float(latest[-1]),
        n_gaps=len(gaps),
        longest_gap=float(gaps.max(initial=0.0)),
        n_backward=sum(t.n_backward for t in times) + sum(b.first < a.last for a, b in pairwise(times)),
    )
