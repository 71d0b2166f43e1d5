"""Parameters of the simulated sets of objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.recognition.cutting import RecognitionParameters
from mlsroad_pipeline.algorithms.segmentation.stage import METHODS
from mlsroad_pipeline.studies.luo2019 import paper as luo2019_paper

BY_HAND = "by_hand"
"""In place of a segmentation: objects are the simulator's instances."""


@dataclass(frozen=True)
class ObjectSetParameters:
    """One simulated set of objects.

    Parameters
    ----------
    share : float
        Objects as a share of the paper's; 1 is as many. Every class has the same share, so that the imbalance is the
        paper's, as far as there are enough objects in the streets.
    survey : mapping
        ``preset`` and changes of `SimulationParameters`, without the seed.
    first_seed : int
        Seed of the first street; the others follow.
    streets : int
        Streets, at least 3: every split has at least one.

    Raises
    ------
    ParameterError
        If a number is out of range or the survey names a seed.
    """

    share: float
    survey: Mapping[str, Any]
    first_seed: int
    streets: int

    def __post_init__(self) -> None:
        if not 0 < self.share <= 1:
            raise ParameterError(f"simulated_objects: share must be above 0 and at most 1, got {self.share!r}")
        if self.streets < len(luo2019_paper.SPLITS) or self.first_seed < 0:
            raise ParameterError(
                f"simulated_objects: streets must be at least {len(luo2019_paper.SPLITS)} and first_seed at least 0, "
                f"got {self.streets!r} and {self.first_seed!r}"
            )
        if "seed" in self.survey:
            raise ParameterError("simulated_objects: the seeds of the streets follow from first_seed")

    def seeds_of_splits(self) -> dict[str, list[int]]:
        """Share the streets out."""
        counts = {name: max(round(share * self.streets), 1) for name, share in luo2019_paper.SPLITS.items()}
        counts["train"] = self.streets - counts["validation"] - counts["test"]
        bounds = np.cumsum([self.first_seed, *counts.values()])
        return {name: list(range(bounds[i], bounds[i + 1])) for i, name in enumerate(counts)}


@dataclass(frozen=True)
class CutParameters:
    """Which segments are objects of a set.

    Parameters
    ----------
    min_points : int
        Smaller ones are left out.
    purity : float
        Share of a segment's points that must be of instances of its class; mixed ones are left out.
    completeness : float
        Share of an instance's points that a segment must hold; smaller pieces are left out.
    max_points : int
        Of larger objects as many points are drawn.
    segmentation : str
        Name of the segmentation, see `SegmentationParameters`; its parameters are those of the stage. "by_hand" takes
        the simulator's instances instead, as the paper's objects were separated by hand.
    reach : float
        Points farther from the track than this are left out, metres.

    Raises
    ------
    ParameterError
        If a value is out of range.
    """

    min_points: int
    purity: float
    completeness: float
    max_points: int
    segmentation: str
    reach: float

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
    """The simulated sets.

    Parameters
    ----------
    scale : str
        Which of `scales` is made.
    scales : mapping
        Name to set, one of ``hdr9`` and ``smd6``, to the fields of `ObjectSetParameters`.
    cut : CutParameters or mapping
        Which segments are objects.
    seed : int
        Seed of the draws.

    Raises
    ------
    ParameterError
        If there is no such scale, or it is wrong.
    """

    scale: str
    scales: Mapping[str, Mapping[str, Any]]
    cut: CutParameters
    seed: int

    def __post_init__(self) -> None:
        if isinstance(self.cut, Mapping):
            object.__setattr__(self, "cut", CutParameters(**self.cut))
        if self.scale not in self.scales:
            raise ParameterError(
                f"simulated_objects.scale {self.scale!r} is unknown (scales: {', '.join(self.scales)})"
            )
        self.chosen_sets()

    def chosen_sets(self) -> dict[str, ObjectSetParameters]:
        """Return the sets that are made."""
        known = sorted(entry.name for entry in fields(ObjectSetParameters))
        found = {}
        for name, given in self.scales[self.scale].items():
            where = f"simulated_objects.scales.{self.scale}.{name}"
            if name not in luo2019_paper.OBJECTS:
                raise ParameterError(f"{where}: the paper has no such set ({', '.join(luo2019_paper.OBJECTS)})")
            if sorted(given) != known:
                raise ParameterError(f"{where} must have {known}, got {sorted(given)}")
            found[name] = ObjectSetParameters(**given)
        return found
