"""Parameters of the study of Tomic et al. 2019: scales, surveys and their division, forests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.stage_parameters import StageParameters
from mlsroad_pipeline.algorithms.features.eigen import SHAPE_FEATURES
from mlsroad_pipeline.algorithms.features.height import GROUND_HEIGHT_FEATURES, OWN_HEIGHT_FEATURES
from mlsroad_pipeline.algorithms.features.orientation import ORIENTATION_FEATURES
from mlsroad_pipeline.algorithms.features.radiometry import INTENSITY_FEATURES
from mlsroad_pipeline.papers.shared.studies.parameters import ScaledStudy
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import ForestParameters

PAPER_FEATURES = (
    *SHAPE_FEATURES, *ORIENTATION_FEATURES, *OWN_HEIGHT_FEATURES, *GROUND_HEIGHT_FEATURES, *INTENSITY_FEATURES
)  # fmt: skip
"""Features of section 2.1: shape from eigenvalues, height, orientation and radiometry."""

PAPER_COLUMNS = ("intensity", "label")
"""Point attributes that the method of section 2.1 uses; colour is left to the images."""

Part = Literal["train", "test", "test1", "test2"]


@dataclass(frozen=True)
class Division:
    """Division of a survey along the road: a training half, test set 1 and test set 2, a quarter each."""

    length: float  # Length of the survey, metres
    # Road between the parts that belongs to none, metres. A larger gap keeps objects from lying in two parts.
    gap: float = 10.0

    def __post_init__(self) -> None:
        if not 0 <= self.gap < self.length / 4:
            raise ParameterError(
                f"tomic2019_study.gap must be at least 0 and below a quarter of the survey's {self.length:g} m, "
                f"got {self.gap!r}"
            )

    def rows(self, station: NDArray[np.floating], part: Part) -> NDArray[np.int64]:
        """Return the points of a part."""
        half, quarter, margin = self.length / 2, 0.75 * self.length, self.gap / 2
        low, high = {
            "train": (-np.inf, half - margin),
            "test": (half + margin, np.inf),
            "test1": (half + margin, quarter - margin),
            "test2": (quarter + margin, np.inf),
        }[part]
        rows = np.flatnonzero((station >= low) & (station <= high))
        if not len(rows):
            raise DataError(f"no point of the survey lies in the part {part!r} of its road")
        return rows


@dataclass(frozen=True)
class ForestVariant:
    """Parameters of a feature-based method."""

    forest: ForestParameters  # forest
    stages: StageParameters  # ground filter, supervoxels and features
    columns: Sequence[str]  # point attributes that it uses
    names: Sequence[str] | None = None  # names of its features, without detrended ones; None means all

    def chosen_features(self, names: Sequence[str]) -> NDArray[np.int64]:
        """Return the columns of the features that are used."""
        if self.names is None:
            return np.arange(len(names))
        return np.flatnonzero([name.removesuffix("_detrended") in self.names for name in names])


@dataclass(frozen=True)
class StudyScale:
    """Surveys and settings of one scale."""

    # ``preset`` and changes of `SimulationParameters` of the divided surveys, without the seed
    survey: Mapping[str, Any]
    seeds: Sequence[int]  # Seeds of these surveys; one experiment each
    # The same for the streets whose images train the network; the kinds alternate
    photographs: Sequence[Mapping[str, Any]]
    photograph_seeds: Sequence[int]  # Seeds of the training images; none is in `seeds`
    gap: float = 10.0  # See `Division`
    # Survey whose first half trains the feature-based method: the next survey in the list, or the labelled survey
    # itself. In the paper, training streets and test set 2 are different streets (its Figures 7 and 9).
    train_on: str = "other"
    # ``image_labels``, ``detrended_forest`` or ``fusion`` to changes of their parameters at this scale
    methods: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        every = [*self.seeds, *self.photograph_seeds]
        if not self.photographs:
            raise ParameterError("tomic2019_study.photographs must have at least one kind of street")
        if not self.seeds or not self.photograph_seeds or len(set(every)) < len(every):
            raise ParameterError(
                f"tomic2019_study: seeds and photograph_seeds must be non-empty and distinct, got "
                f"{list(self.seeds)} and {list(self.photograph_seeds)}"
            )
        if self.train_on not in ("other", "same"):
            raise ParameterError(f"tomic2019_study.train_on must be 'other' or 'same', got {self.train_on!r}")
        if any("seed" in survey for survey in (self.survey, *self.photographs)):
            raise ParameterError(
                "tomic2019_study: survey and photographs must not have a seed; use seeds and photograph_seeds"
            )
        if self.train_on == "other" and len(self.seeds) < 2:
            raise ParameterError("tomic2019_study.train_on is 'other', but seeds has one survey; add one or use 'same'")


@dataclass(frozen=True)
class StudyParameters(ScaledStudy[StudyScale], group="tomic2019_study", kind=StudyScale):
    """Parameters of the study of Tomic et al. 2019."""

    # Changes of the parameters of forest, features and supervoxels for method 1 as printed in section 2.1
    printed_forest: Mapping[str, Any]
    # Changes of the parameters of forest, features and supervoxels for method 1 as printed in section 2.1
    printed_features: Mapping[str, Any]
    # Changes of the parameters of forest, features and supervoxels for method 1 as printed in section 2.1
    printed_supervoxels: Mapping[str, Any] = field(default_factory=dict)
    # Further changes of the forest for the variants with regularised labels (the paper's second conclusion)
    regularised: Mapping[str, Any] = field(default_factory=dict)
