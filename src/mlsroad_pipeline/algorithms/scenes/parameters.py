"""Parameters of the cutting of a survey into scenes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, Self

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.parameter_groups import parse_groups
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive


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
