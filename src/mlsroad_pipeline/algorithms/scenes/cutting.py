"""Parameters of the ingest, cutting of a range of rows, and joining of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Self, TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.parameter_groups import parse_groups
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive
from mlsroad_pipeline.algorithms.geometry.outliers import keep_inliers
from mlsroad_pipeline.algorithms.scenes.corridor import Corridor, MainAxis, main_axis
from mlsroad_pipeline.algorithms.scenes.splits import SplitPart
from mlsroad_pipeline.algorithms.scenes.tiling import PiecedCloud, SceneSpan, assemble_scene, cut_range
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory


@dataclass(frozen=True)
class OutlierParameters:
    """Parameters of the statistical outlier filter, the first step of a method (Tomic et al. 2019, figure 6).

    Parameters
    ----------
    enabled : bool, default False
        Whether the filter is applied; outliers stay in the cloud and get no class.
    k : int, default 12
        Number of nearest points, including the point itself, in the mean distance. Larger values also detect
        small groups of outliers.
    ratio : float, default 4.0
        Threshold in standard deviations above the mean. Larger values remove fewer points.

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
    """Parameters of the cutting of a survey into scenes.

    Parameters
    ----------
    cut : {"along", "file"}, default "along"
        ``"along"``: along the trajectory, or along the main axis of the points without one; ``"file"``: each file is a
        scene, for delivered blocks and single scans.
    scene_length : float, default 30.0
        Length of the core of a scene, metres. Longer scenes read fewer points twice and take more memory (luo2016:
        10 m; yu2016: 50 m).
    buffer : float, default 5.0
        Context on both sides of the core, metres, for neighbourhoods and objects across the border.
    context : float, default 0.0
        Further context on both sides of the buffers, metres, which only labels are computed with; thinned in dense
        surveys. `label` takes what the method needs. Larger costs time and memory.
    bin_length : float, default 1.0
        Granularity of the cuts, metres.
    max_points : int, default 1_500_000
        Largest number of points of a core. It bounds the memory of a worker (about 250 bytes per point of core and
        buffers). In dense surveys a smaller value shortens scenes relative to their buffers: more points are labelled
        twice.
    range_points : int, default 500_000
        Number of points that a worker reads at a time.
    time_gap : float, default 1.0
        Shortest gap in time that the quality report counts, seconds.
    estimate_trajectory : bool, default True
        Whether to estimate the trajectory from points with times per pulse if there is no trajectory file. If the
        estimation fails, the survey is cut along its main axis, and the reason is logged.
    outliers : OutlierParameters or mapping
        Parameters of the statistical outlier filter.

    Raises
    ------
    ParameterError
        If a value is out of range.
    """

    cut: Literal["along", "file"] = "along"
    scene_length: float = 30.0
    buffer: float = 5.0
    context: float = 0.0
    bin_length: float = 1.0
    max_points: int = 1_500_000
    range_points: int = 500_000
    time_gap: float = 1.0
    estimate_trajectory: bool = True
    outliers: OutlierParameters = field(default_factory=OutlierParameters)

    def __post_init__(self) -> None:
        parse_groups(self, outliers=OutlierParameters)
        if self.cut not in ("along", "file"):
            raise ParameterError(f"ingest.cut must be 'along' or 'file', got {self.cut!r}")
        for name in ("scene_length", "bin_length", "max_points", "range_points", "time_gap"):
            check_positive(getattr(self, name), f"ingest.{name}")
        for name in ("buffer", "context"):
            length = getattr(self, name)
            if not np.isfinite(length) or length < 0:
                raise ParameterError(f"ingest.{name} must be a finite number >= 0, got {length!r}")

    def with_context(self, context: float) -> Self:
        """Return the parameters with at least a context, in scenes of at least four times its length.

        Parameters
        ----------
        context : float
            Context that a method needs, metres; 0 changes nothing.

        Returns
        -------
        IngestParameters
            The parameters.
        """
        longest = max(context, self.context)
        return replace(self, context=longest, scene_length=max(self.scene_length, 4 * longest))


class CorridorArrays(TypedDict, total=False):
    """A stored corridor: the arrays of a trajectory, of a main axis, or `none`."""

    trajectory: NDArray[np.float64]  # (n, 3): points of the trajectory, metres
    station: NDArray[np.float64]  # (n,): stations of its points, metres
    time: NDArray[np.float64]  # (n,): times of its points, seconds; empty without times
    centre: NDArray[np.float64]  # (2,): point of the main axis in plan, metres
    direction: NDArray[np.float64]  # (2,): direction of the main axis in plan
    none: NDArray[np.float64]  # empty


class BinCounts(TypedDict):
    """Occupied bins of a range of rows, ascending, and their numbers of points."""

    bins: NDArray[np.int32]
    counts: NDArray[np.int64]


class CutPoints(TypedDict):
    """Stored parts of the points of a range of rows."""

    points: dict[str, NDArray]  # arrays of a `PiecedCloud`
    bins: BinCounts


def corridor_to_arrays(corridor: Corridor) -> CorridorArrays:
    """Return a corridor as named arrays for storage.

    Parameters
    ----------
    corridor : Trajectory, MainAxis or None
        The corridor.

    Returns
    -------
    CorridorArrays
        Arrays for `corridor_from_arrays`.
    """
    if isinstance(corridor, Trajectory):
        times = np.zeros(0) if corridor.time is None else corridor.time
        return {"trajectory": corridor.xyz, "station": corridor.station, "time": times}
    if isinstance(corridor, MainAxis):
        return {"centre": corridor.centre, "direction": corridor.direction}
    return {"none": np.zeros(0)}


def corridor_from_arrays(arrays: CorridorArrays) -> Corridor:
    """Return the corridor of stored arrays.

    Parameters
    ----------
    arrays : CorridorArrays
        Arrays of `corridor_to_arrays`.

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
    """Return the main axis of a survey from samples of its files.

    Parameters
    ----------
    samples : sequence of PointCloud
        Sample of each file.

    Returns
    -------
    MainAxis or None
        The axis; None if all points coincide in plan.
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
    used: NDArray[np.bool_] | None = None,
) -> CutPoints:
    """Return the stored parts of a range of rows: its points sorted into bins, and their counts.

    Parameters
    ----------
    cloud : PointCloud
        Consecutive points of one file.
    corridor : Trajectory, MainAxis or None
        Corridor of the survey.
    part : SplitPart
        Part of the file that belongs to the split.
    along : bool
        Whether to cut along the corridor; otherwise each file is one bin.
    bin_length : float
        Length of a bin, metres.
    first_row : int
        Row of the first point in its file.
    file : int
        Number of the file in its split.
    used : ndarray of shape (n,), bool, optional
        Whether each point is used; others are left out. None uses all.

    Returns
    -------
    CutPoints
        Points sorted into bins, and the occupied bins.

    Raises
    ------
    DataError
        If a column has a reserved name, or the part needs a trajectory and there is none.
    """
    piece = cut_range(cloud, corridor if along else None, bin_length=bin_length, first_row=first_row, file=file)
    keep = None if used is None or used.all() else used[piece.cloud["row"] - first_row]
    if not part.is_whole:
        inside = part.mask(piece.cloud, corridor)
        keep = inside if keep is None else keep & inside
    if keep is not None:
        numbers = np.repeat(piece.bins, np.diff(piece.indptr))[keep]
        bins, starts = np.unique(numbers, return_index=True)
        piece = PiecedCloud(piece.cloud.select(keep), bins, np.append(starts, len(numbers)).astype(np.int64))
    return {"points": piece.to_arrays(), "bins": {"bins": piece.bins, "counts": np.diff(piece.indptr)}}


def join_pieces(
    pieces: Sequence[Mapping[str, NDArray]], span: SceneSpan, outliers: OutlierParameters, source: str
) -> PointCloud:
    """Join a scene from stored pieces.

    Parameters
    ----------
    pieces : sequence of mapping
        Stored pieces with bins of the scene.
    span : SceneSpan
        Bins of the scene.
    outliers : OutlierParameters
        Parameters of the statistical outlier filter.
    source : str
        Name of the scene in messages, with the files that its points come from.

    Returns
    -------
    PointCloud
        Core, buffers and context, float32 relative to an origin at the south-western corner of the scene, with the
        columns of `assemble_scene` and, with the filter, `outlier`.

    Raises
    ------
    DataError
        If the pieces have no point of the scene, repeat a point or have different coordinate systems.
    """
    parts = [PiecedCloud.from_arrays(piece).between(*span.reach) for piece in pieces]
    filled = [part for part in parts if len(part)]
    corner = np.floor(np.min([part.cloud.xyz.min(axis=0) + part.cloud.origin for part in filled], axis=0))
    joined = assemble_scene([_single_precision(part, corner) for part in filled], span)
    scene = replace(joined, source=source)
    if outliers.enabled:
        inlier = keep_inliers(scene.xyz, n_neighbors=outliers.k, std_ratio=outliers.ratio)
        scene = scene.with_columns(outlier=~inlier)
    return scene


def _single_precision(piece: PiecedCloud, origin: NDArray[np.float64]) -> PiecedCloud:
    """Return a piece in float32, relative to another origin."""
    xyz = np.empty(piece.cloud.xyz.shape, dtype=np.float32)
    for axis in range(3):
        xyz[:, axis] = piece.cloud.xyz[:, axis] + (piece.cloud.origin[axis] - origin[axis])
    return replace(piece, cloud=replace(piece.cloud, xyz=xyz, origin=origin))
