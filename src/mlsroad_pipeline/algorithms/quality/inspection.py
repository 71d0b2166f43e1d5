"""Contents of files: ranges of columns, codes, scan lines, map of point density."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_positive

CODED = ("classification", "raw_classification", "label", "return_number", "point_source_id", "scanner_channel")
"""Columns of codes, which are counted like `scanner` and `ring`."""

COUNTED = (*CODED, "scanner", "ring")
ANGLES = ("scan_angle", "scan_angle_rank")
MAX_CODES = 256
"""Largest number of distinct codes that are counted; other columns are summarised by minimum and maximum."""


@dataclass
class ColumnSummary:
    """Summary of the values of a column, updated chunk by chunk."""

    dtype: str  # Type, with the number of values per point if it is not 1
    # minimum, maximum: smallest and largest finite value; NaN without finite values
    minimum: float = np.nan
    maximum: float = np.nan
    n_missing: int = 0  # Number of NaN or infinite values
    # Number of points per code, for columns of codes; None with more than `MAX_CODES` codes
    counts: dict[int, int] | None = None

    def add(self, values: NDArray, *, count: bool) -> None:
        """Add values to the summary."""
        if not values.size:
            return
        low, high = float(values.min()), float(values.max())
        if values.dtype.kind == "f" and not np.isfinite(low + high):
            finite = values[np.isfinite(values)]
            self.n_missing += values.size - finite.size
            low, high = (float(finite.min()), float(finite.max())) if finite.size else (np.nan, np.nan)
        self.minimum, self.maximum = float(np.fmin(self.minimum, low)), float(np.fmax(self.maximum, high))
        if count and self.counts is not None and values.dtype.kind in "iu":
            self.counts = _with_codes(self.counts, values)


def _with_codes(counts: dict[int, int], values: NDArray) -> dict[int, int] | None:
    if values.dtype.itemsize == 1 or 0 <= values.min() <= values.max() < 1 << 16:
        low = int(values.min())
        histogram = np.bincount(values.astype(np.int64) - low)
        codes = np.flatnonzero(histogram)
        numbers, codes = histogram[codes], codes + low
    else:
        codes, numbers = np.unique(values, return_counts=True)
    joined = dict(counts)
    for code, number in zip(codes.tolist(), numbers.tolist(), strict=True):
        joined[code] = joined.get(code, 0) + number
    return dict(sorted(joined.items())) if len(joined) <= MAX_CODES else None


LARGEST_MAP = 1e9
"""Largest extent and height of a map, metres."""


@dataclass
class SurveyMap:
    """Number of points per cell in plan."""

    low: NDArray[np.float64]  # World coordinates of the south-western corner, metres
    cell: float  # Side of a cell, metres
    shape: tuple[int, int]  # Rows (northward) and columns (eastward)
    counts: NDArray[np.int64] = field(init=False)
    top: NDArray[np.float32] = field(init=False)
    n_outside: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        check_positive(self.cell, "cell")
        self.counts = np.zeros(self.shape, dtype=np.int64)
        self.top = np.full(self.shape, -np.inf, dtype=np.float32)

    @classmethod
    def over(cls, low: NDArray[np.float64], high: NDArray[np.float64], *, n_cells: int = 800) -> SurveyMap:
        """Return an empty map of an extent."""
        extent = np.maximum(np.nan_to_num(high[:2] - low[:2]), 0.1)
        cell = max(float(extent.max()) / n_cells, 0.1)
        columns, rows = (np.floor(extent / cell).astype(int) + 2).tolist()
        return cls(np.nan_to_num(low[:2]) - cell / 2, cell, (rows, columns))  # so that rounding loses no border

    def add(self, cloud: PointCloud) -> None:
        """Count points per cell, and the points outside the map."""
        corner = cloud.origin[:2] - self.low
        self.n_outside += _count(cloud.xyz.astype(np.float64, copy=False), corner, self.cell, self.counts, self.top)

    @property
    def drawable(self) -> bool:
        """Whether extent and heights are below `LARGEST_MAP`: damaged files have points beyond all scales."""
        heights = self.top[self.counts > 0]
        return self.cell * max(self.shape) < LARGEST_MAP and bool((np.abs(heights) < LARGEST_MAP).all())

    def density(self) -> NDArray[np.float64]:
        """Return points per square metre, NaN in empty cells; row 0 is in the south."""
        return np.where(self.counts > 0, self.counts / self.cell**2, np.nan)


@njit(cache=True, nogil=True)
def _count(
    xyz: NDArray[np.float64],
    corner: NDArray[np.float64],
    cell: float,
    counts: NDArray[np.int64],
    top: NDArray[np.float32],
) -> int:
    outside = 0
    for i in range(len(xyz)):
        column, row = np.floor((xyz[i, 0] + corner[0]) / cell), np.floor((xyz[i, 1] + corner[1]) / cell)
        if not (0 <= row < counts.shape[0] and 0 <= column < counts.shape[1]):
            outside += 1
            continue
        counts[int(row), int(column)] += 1
        top[int(row), int(column)] = max(top[int(row), int(column)], np.float32(xyz[i, 2]))
    return outside


@dataclass
class ScanLines:
    """Number of scan lines, from jumps of the scan angle."""

    n_jumps: int = 0  # Number of jumps of the scan angle by more than half of its range in the chunk
    n_edges: int = 0  # Number of points flagged as the edge of a line

    def add(self, cloud: PointCloud) -> None:
        """Add points."""
        if "edge_of_flight_line" in cloud:
            self.n_edges += int(np.count_nonzero(cloud["edge_of_flight_line"]))
        name = next((name for name in ANGLES if name in cloud), None)
        if name is not None and len(cloud) > 1:
            angle = cloud[name].astype(np.float64)
            extent = angle.max() - angle.min()
            if extent > 0:
                self.n_jumps += int(np.count_nonzero(np.abs(np.diff(angle)) > extent / 2))


def summarise(cloud: PointCloud, columns: dict[str, ColumnSummary]) -> None:
    """Add points of a file to the summaries of its columns."""
    for name, values in cloud.columns.items():
        if name not in columns:
            width = f" x {values.shape[1]}" if values.ndim > 1 else ""
            columns[name] = ColumnSummary(f"{values.dtype}{width}", counts={} if name in COUNTED else None)
        columns[name].add(values, count=name in COUNTED)


def time_base(start: float, end: float) -> str:
    """Return the probable epoch of times, from their magnitude."""
    if not np.isfinite([start, end]).all():
        return "none"
    if end < 86_400 * 7:
        return "seconds of the GPS week, or of the recording"
    if end < 700_000_000:
        return "adjusted GPS seconds (minus 10^9)"
    return "GPS seconds since 1980" if end < 1_450_000_000 else "seconds since 1970"


def column_warnings(columns: Mapping[str, ColumnSummary]) -> list[str]:
    """Return warnings about the columns of a file."""
    warnings = []
    for name, summary in columns.items():
        if summary.n_missing:
            warnings.append(f"column {name} has {summary.n_missing} NaN or infinite values")
    codes = columns["classification"].counts if "classification" in columns else None
    if codes and max(codes) > 31:
        warnings.append(
            "classification has codes above 31, which LAS point formats 0 to 5 and old viewers do not support"
        )
    return warnings


def constant_columns(columns: Mapping[str, ColumnSummary]) -> tuple[str, ...]:
    """Return the names of colour, intensity and time if all points have the same value."""
    names = ("rgb", "intensity", "gps_time")
    return tuple(n for n in names if n in columns and columns[n].minimum == columns[n].maximum)
