"""Splits of one recording: sections of the trajectory, or sectors of azimuth around a single scan."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_xyz
from mlsroad_pipeline.algorithms.scenes.corridor import Corridor
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory


@dataclass(frozen=True)
class SplitPart:
    """Part of its files that belongs to a split: a section `along` the trajectory, or sectors of azimuth in degrees.

    A `gap` between neighbouring splits belongs to neither: metres along the trajectory, degrees between sectors.
    """

    along: tuple[float, float] | None = None
    sectors: tuple[tuple[float, float], ...] | None = None
    gap: float = 5.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.gap) or self.gap < 0:
            raise ParameterError(f"the gap of a split must be a finite number >= 0, got {self.gap!r}")

    @property
    def is_whole(self) -> bool:
        """Whether whole files belong to the split."""
        return self.along is None and self.sectors is None

    def mask(self, cloud: PointCloud, corridor: Corridor) -> NDArray[np.bool_]:
        """Return which points belong to the part."""
        keep = np.ones(len(cloud), dtype=np.bool_)
        if self.along is not None:
            if not isinstance(corridor, Trajectory):
                raise DataError(f"{cloud.source}: survey.splits with `along` need a trajectory beside the points")
            station, _ = corridor.locate(cloud.xyz, origin=cloud.origin)
            keep &= select_along(station, length=corridor.length, along=self.along, gap=self.gap)
        if self.sectors is not None:
            keep &= select_sectors(cloud.xyz, sectors=self.sectors, gap_degrees=self.gap, centre=-cloud.origin)
        return keep


def split_config(value: Any) -> tuple[list[str], SplitPart]:
    """Return the file patterns and the part of a configured split: a glob, several, or a mapping.

    Its keys are ``files``, ``along: [from, to]``, ``sectors: [[from, to], ...]`` and ``gap``.
    """
    if isinstance(value, str):
        return [value], SplitPart()
    if not isinstance(value, Mapping | Sequence):
        raise ParameterError(f"a split must be a glob, a list of globs or a mapping with files, got {value!r}")
    if not isinstance(value, Mapping):
        return [str(pattern) for pattern in value], SplitPart()
    unknown = sorted(set(value) - {"files", "along", "sectors", "gap"})
    if unknown:
        raise ParameterError(f"unknown keys of a split: {', '.join(unknown)} (known: files, along, sectors, gap)")
    files = value.get("files", ["**/*"])
    along, sectors = value.get("along"), value.get("sectors")
    part = SplitPart(
        along=None if along is None else (float(along[0]), float(along[1])),
        sectors=None if sectors is None else tuple((float(a), float(b)) for a, b in sectors),
        gap=float(value.get("gap", SplitPart.gap)),
    )
    return ([files] if isinstance(files, str) else [str(pattern) for pattern in files]), part


def select_along(station: ArrayLike, *, length: float, along: Sequence[float], gap: float = 0.0) -> NDArray[np.bool_]:
    """Select the points of a section of the trajectory: fractions if both ends are at most 1, metres otherwise.

    Half the gap lies on each side. There is none at the ends of the trajectory: a section that starts at 0 or ends at
    `length` includes the points beyond.
    """
    stations = np.asarray(station, dtype=np.float64)
    first, last = _along_metres(along, length)
    _check_gap(gap, "gap")
    low = -np.inf if first <= 0 else first + gap / 2
    high = np.inf if last >= length else last - gap / 2
    return (stations >= low) & (stations < high)


def select_sectors(
    xyz: ArrayLike,
    *,
    sectors: Sequence[Sequence[float]],
    gap_degrees: float = 0.0,
    centre: ArrayLike = (0.0, 0.0, 0.0),
) -> NDArray[np.bool_]:
    """Select the points of a scan in sectors: degrees counterclockwise from the x axis; ``[300, 60]`` crosses 0."""
    points = check_xyz(xyz)
    _check_gap(gap_degrees, "gap_degrees")
    middle = np.asarray(centre, dtype=np.float64)
    azimuth = np.degrees(np.arctan2(points[:, 1] - middle[1], points[:, 0] - middle[0]))
    selected = np.zeros(len(points), dtype=bool)
    for sector in sectors:
        start, width = _sector(sector)
        if width == 360.0:
            return np.ones(len(points), dtype=bool)
        turn = (azimuth - start) % 360.0
        selected |= (turn >= gap_degrees / 2) & (turn < width - gap_degrees / 2)
    return selected


def check_splits_along(splits: Mapping[str, Sequence[float]], *, length: float) -> None:
    """Check that sections of the trajectory, as in `select_along`, do not overlap."""
    parts = sorted((*_along_metres(along, length), name) for name, along in splits.items())
    for (_, last, one), (first, _, other) in pairwise(parts):
        if first < last:
            raise ParameterError(f"splits {one!r} and {other!r} share the trajectory from {first:g} m to {last:g} m")


def check_splits_sectors(splits: Mapping[str, Sequence[Sequence[float]]]) -> None:
    """Check that sectors, as in `select_sectors`, do not overlap."""
    sectors = [(*_sector(sector), name) for name, group in splits.items() for sector in group]
    for i, (start, width, one) in enumerate(sectors):
        for other_start, other_width, other in sectors[i + 1 :]:
            if (other_start - start) % 360.0 < width or (start - other_start) % 360.0 < other_width:
                raise ParameterError(
                    f"sectors of splits {one!r} and {other!r} overlap: {[start, start + width]} and "
                    f"{[other_start, other_start + other_width]} degrees"
                )


def _along_metres(along: Sequence[float], length: float) -> tuple[float, float]:
    if len(along) != 2 or not np.isfinite(along).all() or not 0 <= along[0] < along[1]:
        raise ParameterError(f"along must be [from, to] with 0 <= from < to, got {list(along)}")
    scale = length if along[1] <= 1 else 1.0
    return along[0] * scale, along[1] * scale


def _sector(sector: Sequence[float]) -> tuple[float, float]:
    """Return start in 0..360 and width of a sector, degrees."""
    if len(sector) != 2 or not np.isfinite(sector).all() or sector[0] == sector[1]:
        raise ParameterError(f"a sector must be [from, to] in degrees, got {list(sector)}")
    if abs(sector[1] - sector[0]) >= 360.0:
        return 0.0, 360.0
    return float(sector[0]) % 360.0, float(sector[1] - sector[0]) % 360.0


def _check_gap(gap: float, name: str) -> None:
    if not np.isfinite(gap) or gap < 0:
        raise ParameterError(f"{name} must be a finite number >= 0, got {gap!r}")
