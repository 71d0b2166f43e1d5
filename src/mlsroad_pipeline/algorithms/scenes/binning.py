"""Points of a range of rows, sorted into bins of the corridor: the first step of cutting a survey into scenes.

A survey is read in ranges of rows, in bounded memory. `cut_points` sorts each range into *bins* of the corridor,
`spans.plan_scenes` plans the scenes from the numbers of points per bin, and `joining.join_pieces` joins each scene from
slices of the ranges. The result does not depend on the size of the ranges.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.scenes.corridor import Corridor
from mlsroad_pipeline.algorithms.scenes.splits import SplitPart

_FARTHEST = 2**30 - 1
"""Largest number of a bin; stray points beyond it are counted in the last bin. Differences of two fit in int32."""


@dataclass(frozen=True)
class BinnedCloud:
    """Points of a range of one file, sorted by bins of the corridor."""

    # The points, with the columns `row` (int64, index in the file) and `file` (int16, index of the file); in file order
    # within a bin
    cloud: PointCloud
    bins: NDArray[np.int32]  # Occupied bins, ascending
    indptr: NDArray[np.int64]  # Points of bin ``bins[i]`` are rows ``indptr[i]`` to ``indptr[i + 1]`` of `cloud`

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.cloud)

    def histogram(self) -> dict[int, int]:
        """Return the number of points per occupied bin."""
        return dict(zip(self.bins.tolist(), np.diff(self.indptr).tolist(), strict=True))

    def between(self, first: int, stop: int) -> BinnedCloud:
        """Return the points of some bins, as views."""
        low, high = np.searchsorted(self.bins, [first, stop])
        rows = slice(self.indptr[low], self.indptr[high])
        columns = {name: values[rows] for name, values in self.cloud.columns.items()}
        cloud = replace(self.cloud, xyz=self.cloud.xyz[rows], columns=columns)
        return BinnedCloud(cloud, self.bins[low:high], self.indptr[low : high + 1] - self.indptr[low])

    def to_arrays(self) -> dict[str, NDArray]:
        """Return named arrays for an NPZ file."""
        text = {"crs": np.array(self.cloud.crs or ""), "source": np.array(self.cloud.source)}
        columns = {f"column.{name}": values for name, values in self.cloud.columns.items()}
        core = {"xyz": self.cloud.xyz, "origin": self.cloud.origin, "bins": self.bins, "indptr": self.indptr}
        return {**core, **columns, **text}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> BinnedCloud:
        """Return the points of arrays of `to_arrays`, or of an open NPZ file."""
        columns = {name.removeprefix("column."): arrays[name] for name in arrays if name.startswith("column.")}
        crs = str(arrays["crs"]) or None
        cloud = PointCloud(arrays["xyz"], columns, arrays["origin"], crs, str(arrays["source"]))
        return cls(cloud, arrays["bins"], arrays["indptr"])


class BinCounts(TypedDict):
    """Occupied bins of a range of rows, ascending, and their numbers of points."""

    bins: NDArray[np.int32]
    counts: NDArray[np.int64]


class CutPoints(TypedDict):
    """Stored parts of the points of a range of rows."""

    points: dict[str, NDArray]  # arrays of a `BinnedCloud`
    bins: BinCounts


def cut_range(
    cloud: PointCloud, corridor: Corridor, *, bin_length: float, first_row: int, file: int = 0
) -> BinnedCloud:
    """Sort a range of rows of a file into bins of the corridor, stably."""
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
        numbers = np.floor(station / bin_length).clip(-_FARTHEST, _FARTHEST).astype(np.int32)
    relative = numbers - (numbers.min() if len(numbers) else 0)
    if relative.max(initial=0) < np.iinfo(np.int16).max:
        relative = relative.astype(np.int16)  # NumPy sorts 16-bit keys by radix sort, in linear time
    order = np.argsort(relative, kind="stable")
    bins, starts = np.unique(numbers[order], return_index=True)
    row = np.arange(first_row, first_row + len(cloud), dtype=np.int64)
    number = np.full(len(cloud), file, dtype=np.int16)
    indptr = np.append(starts, len(cloud)).astype(np.int64)
    return BinnedCloud(cloud.with_columns(row=row, file=number).select(order), bins, indptr)


def cut_points(
    cloud: PointCloud,
    corridor: Corridor,
    part: SplitPart,
    *,
    along: bool,
    bin_length: float,
    first_row: int,
    file: int,
    used: NDArray[np.bool_] | None = None,
) -> CutPoints:
    """Return the stored parts of a range of rows: its points sorted into bins, and their counts."""
    piece = cut_range(cloud, corridor if along else None, bin_length=bin_length, first_row=first_row, file=file)
    keep = None if used is None or used.all() else used[piece.cloud["row"] - first_row]
    if not part.is_whole:
        inside = part.mask(piece.cloud, corridor)
        keep = inside if keep is None else keep & inside
    if keep is not None:
        numbers = np.repeat(piece.bins, np.diff(piece.indptr))[keep]
        bins, starts = np.unique(numbers, return_index=True)
        piece = BinnedCloud(piece.cloud.select(keep), bins, np.append(starts, len(numbers)).astype(np.int64))
    return {"points": piece.to_arrays(), "bins": {"bins": piece.bins, "counts": np.diff(piece.indptr)}}
