"""How a survey is read and cut: parameters, and what becomes of a range of rows and of a scene's pieces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive
from mlsroad_pipeline.algorithms.geometry.outliers import keep_inliers
from mlsroad_pipeline.algorithms.scenes.corridor import Corridor, MainAxis, main_axis
from mlsroad_pipeline.algorithms.scenes.splits import SplitPart
from mlsroad_pipeline.algorithms.scenes.tiling import PiecedCloud, SceneSpan, assemble_scene, cut_range
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory


@dataclass(frozen=True)
class OutlierParameters:
    """The statistical outlier filter, which comes before anything else (Tomic et al. 2019, figure 6).

    Parameters
    ----------
    enabled : bool, default False
        Whether points are looked at; those taken for outliers keep their place and get no class.
    k : int, default 12
        Nearest points, the point itself among them, whose mean distance is looked at. More smooths over small groups
        of stray points.
    ratio : float, default 4.0
        Standard deviations above the mean that make an outlier. Larger removes fewer points.

    Raises
    ------
    ParameterError
        If `k` is below 1 or `ratio` is not above zero.
    """

    enabled: bool = False
    k: int = 12
    ratio: float = 4.0

    def __post_init__(self) -> None:
        check_at_least(self.k, 1, "outliers.k")
        check_positive(self.ratio, "outliers.ratio")


@dataclass(frozen=True)
class IngestParameters:
    """How a survey is cut into scenes.

    Parameters
    ----------
    cut : {"along", "file"}, default "along"
        ``"along"``: along the trajectory where there is one, else along the main axis of the points; ``"file"``:
        each file is a scene, as suits blocks that come cut and single scans.
    scene_length : float, default 30.0
        Length of a scene's core, metres. Longer scenes read fewer points twice and take more memory (luo2016: 10 m;
        yu2016: 50 m).
    buffer : float, default 5.0
        Context on both sides, metres: what neighbourhoods and whole objects need.
    bin_length : float, default 1.0
        Granularity of the cuts, metres.
    max_points : int, default 1_500_000
        The most points of a core: bounds the memory of a worker (about 250 bytes a point of core and buffers). In dense
        surveys a smaller value makes scenes short beside their buffers, and more points are labelled twice.
    range_points : int, default 500_000
        Points that a worker reads at a time.
    time_gap : float, default 1.0
        Seconds without a point that the quality report calls a gap.
    estimate_trajectory : bool, default True
        Whether the path is estimated from the points where no trajectory lies beside them and they have times per
        pulse; where that cannot be done the survey is cut along its main axis, and the log says why.
    outliers : OutlierParameters or mapping
        The statistical outlier filter.

    Raises
    ------
    ParameterError
        If a value is outside its domain.
    """

    cut: Literal["along", "file"] = "along"
    scene_length: float = 30.0
    buffer: float = 5.0
    bin_length: float = 1.0
    max_points: int = 1_500_000
    range_points: int = 500_000
    time_gap: float = 1.0
    estimate_trajectory: bool = True
    outliers: OutlierParameters = field(default_factory=OutlierParameters)

    def __post_init__(self) -> None:
        if isinstance(self.outliers, Mapping):
            object.__setattr__(self, "outliers", OutlierParameters(**self.outliers))
        if self.cut not in ("along", "file"):
            raise ParameterError(f"ingest.cut must be 'along' or 'file', got {self.cut!r}")
        for name in ("scene_length", "bin_length", "max_points", "range_points", "time_gap"):
            check_positive(getattr(self, name), f"ingest.{name}")
        if not np.isfinite(self.buffer) or self.buffer < 0:
            raise ParameterError(f"ingest.buffer must be a finite number >= 0, got {self.buffer!r}")


def corridor_to_arrays(corridor: Corridor) -> dict[str, NDArray]:
    """Turn a corridor into named arrays for storage.

    Parameters
    ----------
    corridor : Trajectory, MainAxis or None
        The corridor.

    Returns
    -------
    dict of str to ndarray
        Arrays from which `corridor_from_arrays` builds it again.
    """
    if isinstance(corridor, Trajectory):
        times = np.zeros(0) if corridor.time is None else corridor.time
        return {"trajectory": corridor.xyz, "station": corridor.station, "time": times}
    if isinstance(corridor, MainAxis):
        return {"centre": corridor.centre, "direction": corridor.direction}
    return {"none": np.zeros(0)}


def corridor_from_arrays(arrays: Mapping[str, NDArray]) -> Corridor:
    """Build a corridor from what `corridor_to_arrays` gave.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        The arrays.

    Returns
    -------
    Trajectory, MainAxis or None
        The corridor.
    """
    if "trajectory" in arrays:
        time = arrays["time"] if len(arrays["time"]) else None
        return Trajectory(time, arrays["trajectory"], arrays["station"])
    if "centre" in arrays:
        return MainAxis(arrays["centre"], arrays["direction"])
    return None


def axis_of_samples(samples: Sequence[PointCloud]) -> MainAxis | None:
    """Find the main axis of a survey from samples of its files.

    Parameters
    ----------
    samples : sequence of PointCloud
        Some points of each file.

    Returns
    -------
    MainAxis or None
        The axis; None where all points stand at one place in plan, which then is one scene.
    """
    points = np.concatenate([sample.world_xyz() for sample in samples])
    if len(points) < 2 or np.ptp(points[:, :2], axis=0).max() == 0.0:
        return None
    return main_axis(points)


def cut_points(
    cloud: PointCloud,
    corridor: Corridor,
    part: SplitPart,
    *,
    along: bool,
    bin_length: float,
    first_row: int,
    file: int,
) -> dict[str, dict[str, NDArray]]:
    """Sort a range of rows into bins, for the parts of a result that are stored.

    Parameters
    ----------
    cloud : PointCloud
        Consecutive points of one file.
    corridor : Trajectory, MainAxis or None
        What the survey is cut along.
    part : SplitPart
        The part of the file that the split takes.
    along : bool
        True cuts along the corridor, False makes each file one bin.
    bin_length : float
        Length of a bin, metres.
    first_row : int
        Row of the first point in its file.
    file : int
        Number of the file in its split.

    Returns
    -------
    dict of str to dict
        ``points``: a `PiecedCloud` as arrays; ``bins``: occupied bins and their number of points.

    Raises
    ------
    DataError
        If a column has a name that is reserved, or the part cannot be taken.
    """
    piece = cut_range(cloud, corridor if along else None, bin_length=bin_length, first_row=first_row, file=file)
    if not part.is_whole:
        keep = part.mask(piece.cloud, corridor)
        numbers = np.repeat(piece.bins, np.diff(piece.indptr))[keep]
        bins, starts = np.unique(numbers, return_index=True)
        piece = PiecedCloud(piece.cloud.select(keep), bins, np.append(starts, len(numbers)).astype(np.int64))
    return {"points": piece.to_arrays(), "bins": {"bins": piece.bins, "counts": np.diff(piece.indptr)}}


def join_pieces(
    pieces: Sequence[Mapping[str, NDArray]], span: SceneSpan, outliers: OutlierParameters, source: str
) -> PointCloud:
    """Assemble a scene from stored pieces.

    Parameters
    ----------
    pieces : sequence of mapping
        Stored pieces that hold bins of the scene.
    span : SceneSpan
        The scene's bins.
    outliers : OutlierParameters
        The statistical outlier filter.
    source : str
        What messages call the scene; it names the files that its points come from.

    Returns
    -------
    PointCloud
        Core and buffers, float32 relative to an origin at the scene's south-western corner, with the columns `core`
        and, where the filter is on, `outlier`.

    Raises
    ------
    DataError
        If the pieces do not fit together.
    """
    parts = [PiecedCloud.from_arrays(piece).between(span.buffer_first, span.buffer_stop) for piece in pieces]
    filled = [part for part in parts if len(part)]
    corner = np.floor(np.min([part.cloud.xyz.min(axis=0) + part.cloud.origin for part in filled], axis=0))
    joined = assemble_scene([_single_precision(part, corner) for part in filled], span)
    scene = replace(joined, source=source)
    if outliers.enabled:
        inlier = keep_inliers(scene.xyz, n_neighbors=outliers.k, std_ratio=outliers.ratio)
        scene = scene.with_columns(outlier=~inlier)
    return scene


def _single_precision(piece: PiecedCloud, origin: NDArray[np.float64]) -> PiecedCloud:
    """Return a piece relative to an origin near it, in half the memory."""
    xyz = np.empty(piece.cloud.xyz.shape, dtype=np.float32)
    for axis in range(3):
        xyz[:, axis] = piece.cloud.xyz[:, axis] + (piece.cloud.origin[axis] - origin[axis])
    return replace(piece, cloud=replace(piece.cloud, xyz=xyz, origin=origin))
