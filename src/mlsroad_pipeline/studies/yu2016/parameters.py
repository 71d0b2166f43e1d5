"""What the study of Yu et al. 2016 runs: its scales, its surveys, and the settings of its figure 12."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.studies.parameters import chosen_scale

WORDS = "visual_words"
DETECTORS = ("hough_forest", "object_matching", "bottom_up_top_down", WORDS)
"""The detectors in the order of the paper's Table V."""

CUT = "normalized_cut"
SEGMENTATIONS = ("yang_dong", "two_step", "normalized_cut_plain", "normalized_cut_geometry", CUT)
"""The segmentations in the order of the paper's Figure 11; the last but one tells what intensities are worth."""


@dataclass(frozen=True)
class StudySurvey:
    """Streets of one kind, which stand for a survey of the paper.

    Parameters
    ----------
    survey : mapping
        ``preset`` and changes of `SimulationParameters`, without the seed; ``street`` is a mapping.
    train, test : sequence of int
        Seeds of the streets to learn from, and of those to be scored on; no street is in both.
    train_survey, test_survey : mapping
        What differs in the streets to learn from, and in those to be scored on.
    rare : sequence of int
        Streets of `train` that hold more of what is rare and easily taken for something else.
    rare_survey : mapping
        What differs in these beside `train_survey`.
    rare_weight : float, default 0.5
        How much their objects count in thresholds, 0 or more; the others, which have as much of what is rare as the
        test streets, count 1. Larger makes thresholds stricter.
    prevalence : mapping of str to float
        Class to how much more frequent it is in streets like the test streets than in the training streets that are
        not `rare`; 1 for what is not named. See `DetectionParameters`.

    Raises
    ------
    ParameterError
        If a list is empty, a street is in both, one of `rare` is not in `train`, all of `train` are rare, `rare_weight`
        is negative, or a survey names a seed.
    """

    survey: Mapping[str, Any]
    train: Sequence[int]
    test: Sequence[int]
    train_survey: Mapping[str, Any] = field(default_factory=dict)
    test_survey: Mapping[str, Any] = field(default_factory=dict)
    rare: Sequence[int] = ()
    rare_survey: Mapping[str, Any] = field(default_factory=dict)
    rare_weight: float = 0.5
    prevalence: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        both = sorted(set(self.train) & set(self.test))
        if not self.train or not self.test or both or len(set(self.test)) < len(self.test):
            raise ParameterError(
                f"yu2016_study: training and test streets must be different and some of each, got {list(self.train)} "
                f"and {list(self.test)}"
            )
        unknown = sorted(set(self.rare) - set(self.train))
        if unknown:
            raise ParameterError(f"yu2016_study: streets {unknown} of `rare` are not among the training streets")
        if set(self.rare) == set(self.train):
            raise ParameterError(
                "yu2016_study: all training streets are `rare`, and none is left to choose thresholds on"
            )
        check_at_least(self.rare_weight, 0.0, "yu2016_study: rare_weight")
        surveys = (self.survey, self.train_survey, self.test_survey, self.rare_survey)
        if any("seed" in given for given in surveys):
            raise ParameterError("yu2016_study: the seeds of the streets stand in train and test")

    def street(self, seed: int) -> dict[str, Any]:
        """Return what is simulated for a street."""
        given = [self.survey, self.train_survey if seed in self.train else self.test_survey]
        given += [self.rare_survey] if seed in self.rare else []
        made: dict[str, Any] = {name: value for changes in given for name, value in changes.items()}
        street = {name: value for changes in given for name, value in changes.get("street", {}).items()}
        return {**made, "street": street, "seed": seed}


@dataclass(frozen=True)
class StudyScale:
    """How large the study is.

    Parameters
    ----------
    surveys : mapping of str to StudySurvey or mapping
        Name of the survey; ``RRS`` and ``SPP`` have the paper's figures beside them.
    patterns : sequence of str
        Patterns of feature regions (Figure 12a), see `RegionParameters`.
    words_per_group : sequence of float
        Sizes of the vocabulary (Figure 12b), as words per training group.
    group_sizes : sequence of int
        Neighbours k in a contextual group (Figure 12c).
    methods : mapping
        Slug to changes of the method's parameters at this scale.
    pooled : bool, default True
        Whether one model of each detector learns from the training streets of all surveys, or one for each survey from
        its own.
    """

    surveys: Mapping[str, Any]
    patterns: Sequence[str]
    words_per_group: Sequence[float]
    group_sizes: Sequence[int]
    methods: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    pooled: bool = True

    def __post_init__(self) -> None:
        made = {name: s if isinstance(s, StudySurvey) else StudySurvey(**s) for name, s in self.surveys.items()}
        if not made:
            raise ParameterError("yu2016_study: a scale must name at least one survey")
        object.__setattr__(self, "surveys", made)

    def learned_together(self) -> list[list[str]]:
        """Return the surveys that one model of a detector learns from and is judged on, for each model."""
        return [list(self.surveys)] if self.pooled else [[name] for name in self.surveys]

    def settings(self) -> dict[str, dict[str, Any]]:
        """Return the settings of Figure 12: name to changes of the parameters of the visual words."""
        found: dict[str, dict[str, Any]] = {f"pattern={p}": {"regions": {"pattern": p}} for p in self.patterns}
        found |= {
            f"words_per_group={w:g}": {"vocabulary": {"n_words": None, "groups_per_word": 1.0 / w}}
            for w in self.words_per_group
        }
        return found | {f"k={k}": {"k": int(k)} for k in self.group_sizes}


@dataclass(frozen=True)
class StudyParameters:
    """The study of Yu et al. 2016.

    Parameters
    ----------
    scale : str
        Which of `scales` is run.
    scales : mapping
        Name to the fields of `StudyScale`.

    Raises
    ------
    ParameterError
        If there is no such scale, or its fields are not those of `StudyScale`.
    """

    scale: str
    scales: Mapping[str, Any]

    def __post_init__(self) -> None:
        self.chosen_scale()

    def chosen_scale(self) -> StudyScale:
        """Return the scale that is run."""
        return chosen_scale(StudyScale, "yu2016_study", self.scale, self.scales)
