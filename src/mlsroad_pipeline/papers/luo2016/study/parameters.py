"""Parameters of the study of Luo et al. 2016: scales, streets and settings to try."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive
from mlsroad_pipeline.papers.shared.studies.parameters import ScaledStudy

GRAPH, REFINED = "patch_graph", "patch_graph_mrf"
PRINTED, PRINTED_REFINED = "patch_graph_printed", "patch_graph_mrf_printed"
METHODS = (
    "patch_svm", "patch_forest", "shape_based", "max_margin_markov", PRINTED, PRINTED_REFINED, GRAPH, REFINED,
)  # fmt: skip
"""The methods in the order of the paper's Table III; the last two are the improved ones."""

AS_PRINTED = (PRINTED, PRINTED_REFINED)
"""Methods on the patches of the paper."""

REFINES = {PRINTED: PRINTED_REFINED, GRAPH: REFINED}
"""Label transfer to its refinement."""

RUNS = tuple(method for method in METHODS if method not in REFINES.values())
"""Trained methods: one run gives label transfer and its refinement."""


@dataclass(frozen=True)
class StudyScale:
    """Streets and settings of one scale."""

    # ``preset`` and changes of `SimulationParameters`, without the seed. Fewer and longer training streets are more
    # similar to each other.
    survey: Mapping[str, Any]
    # Changes of `survey` for test streets. Longer streets take more time and reduce the spread between seeds.
    test_survey: Mapping[str, Any]
    # ``train``: seeds of the training streets, together more than K scenes of 10 m. ``test``: seeds of the test
    # streets, each scored separately. No test street is a training street of any repetition. With its own training
    # streets per repetition, the spread includes that of training; each repetition costs one training per method.
    repetitions: Sequence[Mapping[str, Any]]
    patch_sizes: Sequence[float]  # Patch sizes L of Figures 7 and 8, metres
    search_radii: Sequence[float]  # Local search radii R_loc of Figures 9 to 11, metres
    sensitivity: int  # Repetitions of Figures 7 to 11: the first ones, each with its own training and test streets
    # Maximum patches per training scene in Figures 9 to 11; the search of the paper takes minutes with all patches
    radius_patches: int
    # Changes of `PatchParameters` for all methods but the printed ones, such as more bins than the paper's
    patches: Mapping[str, Any]
    methods: Mapping[str, Mapping[str, Any]]  # Slug to changes of the method's parameters at this scale
    # Slug to the settings that are tried on training streets, each a mapping of parameters. As many for baselines as
    # for the graph keep the comparison fair. Methods without settings here use their own grid search.
    tuning: Mapping[str, Sequence[Mapping[str, Any]]]

    def __post_init__(self) -> None:
        if not self.repetitions or not all(
            set(r) == {"train", "test"} and r["train"] and r["test"] for r in self.repetitions
        ):
            raise ParameterError(
                "luo2016_study.repetitions: each must name its streets as {train: [seeds], test: [seeds]}"
            )
        tests = [seed for repetition in self.repetitions for seed in repetition["test"]]
        both = sorted({seed for repetition in self.repetitions for seed in repetition["train"]} & set(tests))
        if both or len(set(tests)) < len(tests):
            raise ParameterError(
                f"luo2016_study.repetitions: test streets must be distinct and not in training, got {tests}, "
                f"in training {both}"
            )
        check_at_least(self.sensitivity, 0, "luo2016_study.sensitivity")
        check_at_least(self.radius_patches, 1, "luo2016_study.radius_patches")
        for name in ("patch_sizes", "search_radii"):
            for value in getattr(self, name):
                check_positive(value, f"luo2016_study.{name}")
        unknown = sorted(set(self.tuning) - set(RUNS))
        if unknown:
            raise ParameterError(
                f"luo2016_study.tuning: {unknown} are not trained (trained methods: {', '.join(RUNS)})"
            )
        if "seed" in self.survey or "seed" in self.test_survey:
            raise ParameterError(
                "luo2016_study: survey and test_survey must not have a seed; seeds belong in repetitions"
            )


@dataclass(frozen=True)
class StudyParameters(ScaledStudy[StudyScale], group="luo2016_study", kind=StudyScale):
    """Parameters of the study of Luo et al. 2016."""

    scheme: str  # Class scheme; its class ``other`` is learned and counted, but excluded from means
