"""Parameters of the benchmark of recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive

SHIPPED, SIMULATED, OTHERS, OWN, BOTH = "shipped", "simulated", "others", "own", "own_and_simulated"
PROTOCOLS = (SHIPPED, SIMULATED, OTHERS, OWN, BOTH)
"""Training data of a run: those of a model of the package; simulated streets; these and all other recordings; the
recording's own training part; this and simulated streets."""


@dataclass(frozen=True)
class StudyParameters:
    """Parameters of the benchmark of recordings."""

    root: str  # Folder of the recordings
    sources: Mapping[str, Mapping[str, Any]]  # Name of each recording to the fields of `Source`
    # Name of each simulated street to its configuration, as in ``simulation.surveys``; with ``scan_spacing`` it gives
    # single scans
    streets: Mapping[str, Mapping[str, Any]]
    street_weight: float  # Weight of all simulated streets together, for methods that weigh sources; a recording has 1
    scheme: str  # Class scheme of training and scoring. Its class ``other`` is counted, but no part of means.
    # Models of the package to score. ``pool`` has the other protocols too: with trees of the protocol and the network
    # of the package, which was trained on simulated streets alone.
    models: Sequence[str]
    method: str | None  # Method or model to run alone; None runs all labellers that need no images
    source: str | None  # Recording to score alone; None scores all
    # Protocol to run alone: ``shipped``, ``simulated``, ``others``, ``own`` or ``own_and_simulated``; None runs all
    protocol: str | None
    # Width of the strip between training part and test part, metres. It exceeds the least distance of the two, 5 m, by
    # the error of the poses.
    gap: float
    scenes_per_source: int  # Most scenes of a recording to train on, evenly spread; more take longer
    least_points: int  # Fewest points of a class in the scored part; rarer classes are no part of means
    pictured: Sequence[str]  # Runs that are drawn, as ``method.protocol``

    def __post_init__(self) -> None:
        for name in ("gap", "street_weight"):
            check_positive(getattr(self, name), f"recordings_study.{name}")
        for name in ("scenes_per_source", "least_points"):
            check_at_least(getattr(self, name), 1, f"recordings_study.{name}")
        if self.protocol not in (None, *PROTOCOLS):
            raise ParameterError(f"recordings_study.protocol {self.protocol!r} is none of {', '.join(PROTOCOLS)}")
