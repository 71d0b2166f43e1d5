"""Plan of the scenes of a survey: the bins of the corridor that belong to each scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive

CONTEXT_POINTS = 100_000
"""Points of the context that are never thinned."""


@dataclass(frozen=True)
class SceneSpan:
    """Bins of one scene, as half-open ranges."""

    id: str  # Name of the scene, such as ``"scene_00012"``, numbered along the corridor
    first: int  # Bins of the core
    stop: int  # Bins of the core
    buffer_first: int  # Bins of the core and its buffers
    buffer_stop: int  # Bins of the core and its buffers
    n_core: int  # Number of points in the core, and in core and buffers
    n_points: int  # Number of points in the core, and in core and buffers
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
