"""Parameters of the cutting of a survey into scenes."""

from dataclasses import dataclass, field, replace
from typing import Literal, Self

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive, parse_groups


@dataclass(frozen=True)
class OutlierParameters:
    """Parameters of the statistical outlier filter, the first step of a method (Tomic et al. 2019, figure 6)."""

    enabled: bool = False  # Whether the filter is applied; outliers stay in the cloud and get no class
    # Number of nearest points, including the point itself, in the mean distance. Larger values also detect small groups
    # of outliers.
    k: int = 12
    ratio: float = 4.0  # Threshold in standard deviations above the mean. Larger values remove fewer points.

    def __post_init__(self) -> None:
        check_at_least(self.k, 1, "outliers.k")
        check_positive(self.ratio, "outliers.ratio")


@dataclass(frozen=True)
class IngestParameters:
    """Parameters of the cutting of a survey into scenes."""

    # ``"along"``: along the trajectory, or along the main axis of the points without one; ``"file"``: each file is a
    # scene, for delivered blocks and single scans
    cut: Literal["along", "file"] = "along"
    # Length of the core of a scene, metres. Longer scenes read fewer points twice and take more memory (luo2016: 10 m;
    # yu2016: 50 m).
    scene_length: float = 30.0
    buffer: float = 5.0  # Context on both sides of the core, metres, for neighbourhoods and objects across the border
    # Further context on both sides of the buffers, metres, which only labels are computed with; thinned in dense
    # surveys. `label` takes what the method needs. Larger costs time and memory.
    context: float = 0.0
    bin_length: float = 1.0  # Granularity of the cuts, metres
    # Largest number of points of a core. It bounds the memory of a worker (about 250 bytes per point of core and
    # buffers). In dense surveys a smaller value shortens scenes relative to their buffers: more points are labelled
    # twice.
    max_points: int = 1_500_000
    range_points: int = 500_000  # Number of points that a worker reads at a time
    time_gap: float = 1.0  # Shortest gap in time that the quality report counts, seconds
    # Whether to estimate the trajectory from points with times per pulse if there is no trajectory file. If the
    # estimation fails, the survey is cut along its main axis, and the reason is logged.
    estimate_trajectory: bool = True
    # Parameters of the statistical outlier filter
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
        """Return the parameters with at least a context, in scenes of at least four times its length."""
        longest = max(context, self.context)
        return replace(self, context=longest, scene_length=max(self.scene_length, 4 * longest))
