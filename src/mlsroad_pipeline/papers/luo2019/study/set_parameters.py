"""Parameters of the simulated sets of objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.parameter_groups import parse_groups
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.segmentation.stage import METHODS
from mlsroad_pipeline.papers.luo2019.study import paper as luo2019_paper
from mlsroad_pipeline.papers.shared.recognition.cutting import RecognitionParameters
from mlsroad_pipeline.papers.shared.studies.parameters import from_fields, scale_values

BY_HAND = "by_hand"
"""Name for objects that are the simulator's instances instead of segments."""


@dataclass(frozen=True)
class ObjectSetParameters:
    """Parameters of one simulated set of objects."""

    # Objects as a share of the paper's; 1 is the same number. Every class has the same share, so that the class
    # imbalance is the paper's as far as the streets have enough objects.
    share: float
    survey: Mapping[str, Any]  # ``preset`` and changes of `SimulationParameters`, without the seed
    first_seed: int  # Seed of the first street; the seeds are consecutive
    streets: int  # Number of streets, at least 3: every split has at least one

    def __post_init__(self) -> None:
        if not 0 < self.share <= 1:
            raise ParameterError(f"simulated_objects: share must be above 0 and at most 1, got {self.share!r}")
        if self.streets < len(luo2019_paper.SPLITS) or self.first_seed < 0:
            raise ParameterError(
                f"simulated_objects: streets must be at least {len(luo2019_paper.SPLITS)} and first_seed at least 0, "
                f"got {self.streets!r} and {self.first_seed!r}"
            )
        if "seed" in self.survey:
            raise ParameterError(
                "simulated_objects: survey must not have a seed; the seeds of the streets follow from first_seed"
            )

    def seeds_of_splits(self) -> dict[str, list[int]]:
        """Return the seeds of the streets of each split."""
        counts = {name: max(round(share * self.streets), 1) for name, share in luo2019_paper.SPLITS.items()}
        counts["train"] = self.streets - counts["validation"] - counts["test"]
        bounds = np.cumsum([self.first_seed, *counts.values()])
        return {name: list(range(bounds[i], bounds[i + 1])) for i, name in enumerate(counts)}


@dataclass(frozen=True)
class CutParameters:
    """Selection of the segments that become objects of a set."""

    min_points: int  # Fewest points of an object; smaller segments are excluded
    purity: float  # Smallest share of a segment's points in instances of its class; mixed segments are excluded
    completeness: float  # Smallest share of an instance's points in its segment; smaller fragments are excluded
    max_points: int  # Most points of an object; larger ones are sampled randomly
    # Name of the segmentation, see `SegmentationParameters`; its parameters are those of the stage. "by_hand" takes the
    # simulator's instances instead, as the paper's objects were separated by hand.
    segmentation: str
    reach: float  # Largest distance of points from the track, metres

    def __post_init__(self) -> None:
        RecognitionParameters(min_points=self.min_points, purity=self.purity)
        if self.max_points < self.min_points:
            raise ParameterError(f"simulated_objects.cut.max_points {self.max_points!r} is below min_points")
        if not 0 <= self.completeness <= 1:
            raise ParameterError(f"simulated_objects.cut.completeness must be in [0, 1], got {self.completeness!r}")
        known = (*METHODS, BY_HAND)
        if self.segmentation not in known:
            raise ParameterError(
                f"simulated_objects.cut.segmentation must be one of {', '.join(known)}, got {self.segmentation!r}"
            )
        check_positive(self.reach, "simulated_objects.cut.reach")


@dataclass(frozen=True)
class SimulatedObjectsParameters:
    """Parameters of the simulated sets."""

    scale: str  # Name of the scale that is made
    # Name of each scale to its sets, ``hdr9`` or ``smd6``, each with the fields of `ObjectSetParameters`
    scales: Mapping[str, Mapping[str, Any]]
    cut: CutParameters  # Selection of the segments that become objects
    seed: int  # Seed of the sampling of objects

    def __post_init__(self) -> None:
        parse_groups(self, cut=CutParameters)
        self.chosen_sets()

    def chosen_sets(self) -> dict[str, ObjectSetParameters]:
        """Return the parameters of the sets of the scale."""
        sets = {}
        for name, values in scale_values("simulated_objects", self.scale, self.scales).items():
            where = f"simulated_objects.scales.{self.scale}.{name}"
            if name not in luo2019_paper.OBJECTS:
                raise ParameterError(f"{where}: the paper has no such set (sets: {', '.join(luo2019_paper.OBJECTS)})")
            sets[name] = from_fields(ObjectSetParameters, where, values)
        return sets
