"""Parameters of the study of Yu et al. 2016: scales, surveys, settings of Figure 12, and keys of the stores."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.papers.shared.studies.parameters import ScaledStudy


def street_key(survey: str, seed: int) -> str:
    """Return the key of a street."""
    return f"{survey}.seed_{seed}"


def run_key(survey: str, seed: int) -> str:
    """Return the key of a street in the result of a run."""
    return f"{survey}_{seed}"


def survey_of_run(key: str) -> str:
    """Return the survey of a key of `run_key`."""
    return key.rpartition("_")[0]


def model_key(detector: str, surveys: Sequence[str]) -> str:
    """Return the key of the model of a detector that is trained on some surveys."""
    return f"{detector}.{'_'.join(surveys)}"


def detector_of_model(key: str) -> str:
    """Return the detector of a key of `model_key`."""
    return key.partition(".")[0]


def setting_key(name: str) -> str:
    """Return the key of a setting in a store."""
    return name.replace("=", "-").replace(".", "_")


WORDS, PRINTED = "visual_words", "visual_words_printed"
METHODS_OF_STUDY = ("hough_forest", "object_matching", "bottom_up_top_down", WORDS, PRINTED)
"""Methods whose parameters the study takes, in the order of the paper's Table V."""

FLOORED = "visual_words_printed_floor"
"""The method as printed with the least context factor of `visual_words`: equation 16 itself has 0."""

DETECTORS = (*METHODS_OF_STUDY, FLOORED)
"""Detectors that a scale may run."""

CUT, PRINTED_CUT = "normalized_cut", "normalized_cut_printed"
SEGMENTATIONS = (
    "yang_dong", "two_step", "normalized_cut_plain", PRINTED_CUT, "normalized_cut_geometry", CUT
)  # fmt: skip
"""Segmentations in the order of the paper's Figure 11; the last but one shows the effect of intensity."""


def method_of(detector: str) -> str:
    """Return the method of a detector of the study."""
    return PRINTED if detector == FLOORED else detector


def cut_of(detector: str) -> str:
    """Return the segmentation whose objects a detector classifies."""
    return PRINTED_CUT if method_of(detector) == PRINTED else CUT


@dataclass(frozen=True)
class StudySurvey:
    """Streets of one kind, in place of a survey of the paper."""

    # ``preset`` and changes of `SimulationParameters`, without the seed; ``street`` is a mapping
    survey: Mapping[str, Any]
    # train, test: seeds of the training and test streets; no street is in both
    train: Sequence[int]
    test: Sequence[int]
    # train_survey, test_survey: changes of `survey` for training and for test streets
    train_survey: Mapping[str, Any] = field(default_factory=dict)
    test_survey: Mapping[str, Any] = field(default_factory=dict)
    rare: Sequence[int] = ()  # Streets of `train` with more rare objects that are easily confused with a class
    # Changes of these streets in addition to `train_survey`
    rare_survey: Mapping[str, Any] = field(default_factory=dict)
    # Weight of the objects of `rare` streets in the selection of thresholds, at least 0; objects of other training
    # streets have weight 1. A larger weight gives stricter thresholds.
    rare_weight: float = 0.5
    # Class to its frequency in streets like the test streets, relative to the training streets that are not `rare`; 1
    # for classes that are absent here. See `DetectionParameters`.
    prevalence: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        both = sorted(set(self.train) & set(self.test))
        if not self.train or not self.test or both or len(set(self.test)) < len(self.test):
            raise ParameterError(
                f"yu2016_study: train and test must be non-empty and distinct, got {list(self.train)} and "
                f"{list(self.test)}"
            )
        unknown = sorted(set(self.rare) - set(self.train))
        if unknown:
            raise ParameterError(f"yu2016_study: streets {unknown} of `rare` are not in train")
        if set(self.rare) == set(self.train):
            raise ParameterError(
                "yu2016_study: all training streets are `rare`; thresholds need at least one that is not"
            )
        check_at_least(self.rare_weight, 0.0, "yu2016_study: rare_weight")
        surveys = (self.survey, self.train_survey, self.test_survey, self.rare_survey)
        if any("seed" in survey for survey in surveys):
            raise ParameterError("yu2016_study: surveys must not have a seed; seeds belong in train and test")

    def street(self, seed: int) -> dict[str, Any]:
        """Return the configuration of the simulated survey of a street."""
        layers = [self.survey, self.train_survey if seed in self.train else self.test_survey]
        layers += [self.rare_survey] if seed in self.rare else []
        merged: dict[str, Any] = {name: value for changes in layers for name, value in changes.items()}
        street = {name: value for changes in layers for name, value in changes.get("street", {}).items()}
        return {**merged, "street": street, "seed": seed}


@dataclass(frozen=True)
class StudyScale:
    """Surveys and settings of one scale."""

    surveys: Mapping[str, Any]  # Surveys by name; ``RRS`` and ``SPP`` are compared with the paper's results
    patterns: Sequence[str]  # Patterns of feature regions (Figure 12a), see `RegionParameters`
    words_per_group: Sequence[float]  # Sizes of the vocabulary (Figure 12b), as words per training group
    group_sizes: Sequence[int]  # Neighbours k in a contextual group (Figure 12c)
    # Those of `DETECTORS` that are run; `visual_words` is always among them
    detectors: Sequence[str] = METHODS_OF_STUDY[:4]
    varied: str = WORDS  # Detector whose settings Figure 12 varies, one of the visual words
    # Slug to changes of the method's parameters at this scale
    methods: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    # Train one model of each detector on the training streets of all surveys; False trains one model per survey
    pooled: bool = True

    def __post_init__(self) -> None:
        made = {name: s if isinstance(s, StudySurvey) else StudySurvey(**s) for name, s in self.surveys.items()}
        if not made:
            raise ParameterError("yu2016_study.surveys must have at least one survey")
        object.__setattr__(self, "surveys", made)
        unknown = sorted(set(self.detectors) - set(DETECTORS))
        if unknown or WORDS not in self.detectors:
            raise ParameterError(
                f"yu2016_study.detectors must be of {', '.join(DETECTORS)} and have {WORDS}, got {list(self.detectors)}"
            )
        if self.varied not in self.detectors or not self.varied.startswith(WORDS):
            raise ParameterError(f"yu2016_study.varied must be one of the visual words that run, got {self.varied!r}")

    def learned_together(self) -> list[list[str]]:
        """Return the surveys that each model of a detector is trained and tested on."""
        return [list(self.surveys)] if self.pooled else [[name] for name in self.surveys]

    def settings(self) -> dict[str, dict[str, Any]]:
        """Return the settings of Figure 12 by name, as changes of the parameters of the visual words."""
        settings: dict[str, dict[str, Any]] = {f"pattern={p}": {"regions": {"pattern": p}} for p in self.patterns}
        settings |= {
            f"words_per_group={w:g}": {"vocabulary": {"n_words": None, "groups_per_word": 1.0 / w}}
            for w in self.words_per_group
        }
        return settings | {f"k={k}": {"k": int(k)} for k in self.group_sizes}


@dataclass(frozen=True)
class StudyParameters(ScaledStudy[StudyScale], group="yu2016_study", kind=StudyScale):
    """Parameters of the study of Yu et al. 2016."""
