"""What the study of Luo et al. 2016 runs: its scales, its streets, and the settings that are tried."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.studies.parameters import chosen_scale

GRAPH, REFINED = "patch_graph", "patch_graph_mrf"
METHODS = ("patch_svm", "patch_forest", "shape_based", "max_margin_markov", GRAPH, REFINED)
"""The methods in the order of the paper's Table III."""

RUNS = METHODS[:-1]
"""What is trained: label transfer and its refinement come of one graph."""


@dataclass(frozen=True)
class StudyScale:
    """How large the study is.

    Parameters
    ----------
    survey : mapping
        ``preset`` and changes of `SimulationParameters`, without the seed. Training streets are the more alike the
        fewer and longer they are.
    test_survey : mapping
        What is different for test streets. Longer streets take more time and narrow the spread between seeds.
    repetitions : sequence of mapping
        ``train``, the seeds of streets that every method learns from, together more than K scenes of 10 m; ``test``,
        the seeds of streets that it is scored on, one repetition each. No street is in the training and in the test of
        any. Other training streets for each test street make the spread one of training too, and cost as many
        trainings.
    patch_sizes : sequence of float
        Patch sizes L of Figures 7 and 8, metres.
    search_radii : sequence of float
        Local search radii R_loc of Figures 9 to 11, metres.
    methods : mapping
        Slug to changes of the method's parameters at this scale.
    tuning : mapping
        Slug to the settings that are tried on training streets, each a mapping of parameters. As many for every method
        keep the comparison level. Methods without settings here choose by a grid of their own.

    Raises
    ------
    ParameterError
        If a repetition lacks streets, a street is in training and test, a length is not above 0, or a method with
        settings is not trained.
    """

    survey: Mapping[str, Any]
    test_survey: Mapping[str, Any]
    repetitions: Sequence[Mapping[str, Any]]
    patch_sizes: Sequence[float]
    search_radii: Sequence[float]
    methods: Mapping[str, Mapping[str, Any]]
    tuning: Mapping[str, Sequence[Mapping[str, Any]]]

    def __post_init__(self) -> None:
        if not self.repetitions or not all(
            set(r) == {"train", "test"} and r["train"] and r["test"] for r in self.repetitions
        ):
            raise ParameterError(
                "luo2016_study: each repetition must name its streets: {train: [seeds], test: [seeds]}"
            )
        tests = [seed for repetition in self.repetitions for seed in repetition["test"]]
        both = sorted({seed for repetition in self.repetitions for seed in repetition["train"]} & set(tests))
        if both or len(set(tests)) < len(tests):
            raise ParameterError(f"luo2016_study: a test street is met once, got {tests} and in training {both}")
        for name in ("patch_sizes", "search_radii"):
            for value in getattr(self, name):
                check_positive(value, f"luo2016_study.{name}")
        unknown = sorted(set(self.tuning) - set(RUNS))
        if unknown:
            raise ParameterError(f"luo2016_study.tuning: {unknown} are not trained (methods: {', '.join(RUNS)})")
        if "seed" in self.survey or "seed" in self.test_survey:
            raise ParameterError("luo2016_study: the seeds of the streets stand in repetitions")


@dataclass(frozen=True)
class StudyParameters:
    """The study of Luo et al. 2016.

    Parameters
    ----------
    scale : str
        Which of `scales` is run.
    scales : mapping
        Name to the fields of `StudyScale`.
    scheme : str
        The class scheme; its class ``other`` is learned and counted, but is in no mean.
    sensitivity : int
        How many test streets Figures 7 to 11 are made of: the first ones of the first repetition.

    Raises
    ------
    ParameterError
        If there is no such scale, or it is wrong.
    """

    scale: str
    scales: Mapping[str, Any]
    scheme: str
    sensitivity: int

    def __post_init__(self) -> None:
        self.chosen_scale()
        if self.sensitivity < 0:
            raise ParameterError(f"luo2016_study.sensitivity must be at least 0, got {self.sensitivity!r}")

    def chosen_scale(self) -> StudyScale:
        """Return the scale that is run."""
        return chosen_scale(StudyScale, "luo2016_study", self.scale, self.scales)
