"""The parts of its files that a split takes: along the way, or by azimuth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.scenes.corridor import Corridor
from mlsroad_pipeline.algorithms.scenes.splits import select_along, select_sectors
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory


@dataclass(frozen=True)
class SplitPart:
    """The part of its files that a split takes.

    Parameters
    ----------
    along : tuple of two floats, optional
        From and to along the way: fractions where both are at most 1, metres otherwise.
    sectors : tuple of (from, to), optional
        Azimuths of a single scan, degrees counterclockwise from the x axis.
    gap : float, default 5.0
        What is left out between neighbouring splits: metres along the way, degrees between sectors.
    """

    along: tuple[float, float] | None = None
    sectors: tuple[tuple[float, float], ...] | None = None
    gap: float = 5.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.gap) or self.gap < 0:
            raise ParameterError(f"the gap of a split must be a finite number >= 0, got {self.gap!r}")

    @property
    def is_whole(self) -> bool:
        """Whether the split takes its files whole."""
        return self.along is None and self.sectors is None

    def mask(self, cloud: PointCloud, corridor: Corridor) -> NDArray[np.bool_]:
        """Tell which points belong to this part.

        Parameters
        ----------
        cloud : PointCloud
            Points of one of the split's files.
        corridor : Trajectory, MainAxis or None
            What the survey is cut along.

        Returns
        -------
        ndarray of bool, shape (n,)
            True in the part.

        Raises
        ------
        DataError
            If a part along the way is asked for of a survey without a trajectory.
        """
        keep = np.ones(len(cloud), dtype=np.bool_)
        if self.along is not None:
            if not isinstance(corridor, Trajectory):
                raise DataError(f"{cloud.source}: a split along the way needs a trajectory beside the points")
            station, _ = corridor.locate(cloud.xyz, origin=cloud.origin)
            keep &= select_along(station, length=corridor.length, along=self.along, gap=self.gap)
        if self.sectors is not None:
            keep &= select_sectors(cloud.xyz, sectors=self.sectors, gap_degrees=self.gap, centre=-cloud.origin)
        return keep


def split_config(value: Any) -> tuple[list[str], SplitPart]:
    """Read a split from configuration.

    Parameters
    ----------
    value : str, sequence of str or mapping
        A glob, several, or ``{files: [globs], along: [from, to], sectors: [[from, to], ...], gap: metres or degrees}``.

    Returns
    -------
    globs : list of str
        Globs below the survey's root.
    part : SplitPart
        The part of those files.

    Raises
    ------
    ParameterError
        If a key is unknown, or the value is none of these.
    """
    if isinstance(value, str):
        return [value], SplitPart()
    if not isinstance(value, Mapping | Sequence):
        raise ParameterError(f"a split is a glob, a list of globs or a mapping with files, got {value!r}")
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
