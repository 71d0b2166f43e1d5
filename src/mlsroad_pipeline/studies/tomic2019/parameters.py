"""What the study of Tomic et al. 2019 runs: its scales, its surveys, how they are divided, and its forests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.detrended_forest.labeller import StageParameters
from mlsroad_pipeline.algorithms.detrended_forest.training import ForestParameters
from mlsroad_pipeline.algorithms.features.eigen import SHAPE_FEATURES
from mlsroad_pipeline.algorithms.features.height import GROUND_HEIGHT_FEATURES, OWN_HEIGHT_FEATURES
from mlsroad_pipeline.algorithms.features.orientation import ORIENTATION_FEATURES
from mlsroad_pipeline.algorithms.features.radiometry import INTENSITY_FEATURES
from mlsroad_pipeline.studies.parameters import chosen_scale

PAPER_FEATURES = (
    *SHAPE_FEATURES, *ORIENTATION_FEATURES, *OWN_HEIGHT_FEATURES, *GROUND_HEIGHT_FEATURES, *INTENSITY_FEATURES
)  # fmt: skip
"""The features that section 2.1 names: shape from eigenvalues, height, orientation and radiometry."""

PAPER_COLUMNS = ("intensity", "label")
"""What that method knows of the points: no colour, which the images bring."""

Part = Literal["train", "test", "test1", "test2"]


@dataclass(frozen=True)
class Division:
    """How a survey is divided along the road: a training half, test set 1 and test set 2, a quarter each.

    Parameters
    ----------
    length : float
        Of the survey, metres.
    gap : float, default 10.0
        Road between the parts that belongs to none, metres. More keeps objects from lying in two parts.

    Raises
    ------
    ParameterError
        If the parts have no length.
    """

    length: float
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
        found = np.flatnonzero((station >= low) & (station <= high))
        if not len(found):
            raise DataError(f"no point of the survey lies in the part {part!r} of its road")
        return found


@dataclass(frozen=True)
class ForestVariant:
    """A feature-based method.

    Parameters
    ----------
    forest : ForestParameters
        The forest.
    stages : StageParameters
        Ground filter, supervoxels and features.
    columns : sequence of str
        What it knows of the points.
    names : sequence of str or None
        Its features, without those that are detrended from them; None is all.
    """

    forest: ForestParameters
    stages: StageParameters
    columns: Sequence[str]
    names: Sequence[str] | None = None

    def chosen_features(self, names: Sequence[str]) -> NDArray[np.int64]:
        """Return the columns of the features that it has."""
        if self.names is None:
            return np.arange(len(names))
        return np.flatnonzero([name.removesuffix("_detrended") in self.names for name in names])


@dataclass(frozen=True)
class StudyScale:
    """How large the study is.

    Parameters
    ----------
    survey : mapping
        ``preset`` and changes of `SimulationParameters` of the surveys that are divided, without the seed.
    seeds : sequence of int
        Seeds of these surveys; one experiment each.
    photographs : sequence of mapping
        Likewise of the streets whose images the network learns from, taken in turn.
    photograph_seeds : sequence of int
        Their seeds, none of which is in `seeds`.
    gap : float
        See `Division`.
    train_on : {"other", "same"}, default "other"
        Whose first half trains the feature-based method: that of the next survey in the list, or of the survey that it
        then labels. The paper's training streets are others than those of test set 2 (its Figures 7 and 9).
    methods : mapping
        ``image_labels``, ``detrended_forest`` or ``fusion`` to changes of their parameters at this scale.

    Raises
    ------
    ParameterError
        If a list is empty, a street is in both or twice, a survey names a seed, or there is no other survey to train
        on.
    """

    survey: Mapping[str, Any]
    seeds: Sequence[int]
    photographs: Sequence[Mapping[str, Any]]
    photograph_seeds: Sequence[int]
    gap: float = 10.0
    train_on: str = "other"
    methods: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        every = [*self.seeds, *self.photograph_seeds]
        if not self.photographs:
            raise ParameterError("tomic2019_study.photographs must name at least one kind of street")
        if not self.seeds or not self.photograph_seeds or len(set(every)) < len(every):
            raise ParameterError(
                f"tomic2019_study: seeds and photograph_seeds must be different and some of each, got "
                f"{list(self.seeds)} and {list(self.photograph_seeds)}"
            )
        if self.train_on not in ("other", "same"):
            raise ParameterError(f"tomic2019_study.train_on must be 'other' or 'same', got {self.train_on!r}")
        if any("seed" in survey for survey in (self.survey, *self.photographs)):
            raise ParameterError("tomic2019_study: the seeds of the streets stand in seeds and photograph_seeds")
        if self.train_on == "other" and len(self.seeds) < 2:
            raise ParameterError("tomic2019_study.train_on is 'other', but seeds name one survey alone")


@dataclass(frozen=True)
class StudyParameters:
    """The study of Tomic et al. 2019.

    Parameters
    ----------
    scale : str
        Which of `scales` is run.
    scales : mapping
        Name to the fields of `StudyScale`.
    printed_forest, printed_features : mapping
        Changes of the parameters of forest and features that make method 1 that of section 2.1.

    Raises
    ------
    ParameterError
        If there is no such scale, or its fields are not those of `StudyScale`.
    """

    scale: str
    scales: Mapping[str, Any]
    printed_forest: Mapping[str, Any]
    printed_features: Mapping[str, Any]

    def __post_init__(self) -> None:
        self.chosen_scale()

    def chosen_scale(self) -> StudyScale:
        """Return the scale that is run."""
        return chosen_scale(StudyScale, "tomic2019_study", self.scale, self.scales)
