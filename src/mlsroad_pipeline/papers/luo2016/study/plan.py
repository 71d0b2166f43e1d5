"""Scales, streets, settings and runs of the study of Luo et al. 2016, and their tasks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme, find_scheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.papers.luo2016.study.runs import (
    AS_PRINTED,
    GRAPH,
    PRINTED,
    PRINTED_BASELINES,
    REFINES,
    RUNS,
    RunResult,
    cut_patches,
    train_and_score,
)
from mlsroad_pipeline.papers.luo2016.study.scores import repetition_scores
from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters, PatchStages
from mlsroad_pipeline.papers.shared.studies.parameters import ScaledStudy, changed, method_parameters
from mlsroad_pipeline.papers.shared.studies.streets import street_key


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


def patches_key(seed: int, sizes: PatchParameters) -> str:
    """Return the key of a street's patches of one size and number of bins."""
    return f"seed_{seed}.size_{sizes.patch_size:g}.bins_{sizes.n_bins}"


@dataclass(frozen=True)
class StudyRun:
    """Training and scoring of one method."""

    key: str  # key in the store
    method: str  # one of `RUNS`
    # train, test: seeds of the streets
    train: tuple[int, ...]
    test: tuple[int, ...]
    sizes: PatchParameters  # parameters of the patches
    parameters: Mapping[str, Any]  # slug to parameters
    pictured: bool = False  # whether the labels of the first test street are kept


@dataclass(frozen=True)
class StudyPlan:
    """Parameters of all stages of the study, and the runs that follow from them."""

    study: StudyParameters  # scale and scheme
    scheme: ClassScheme  # classes
    ground: GroundParameters  # ground filter
    sizes: PatchParameters  # patches of the printed methods
    parameters: Mapping[str, Any]  # slug to the parameters of the method, changes of the scale included

    @property
    def scale(self) -> StudyScale:
        """Return the scale that is run."""
        return self.study.chosen_scale()

    def surveys(self) -> dict[str, dict[str, Any]]:
        """Return the configuration of the simulated survey of every street."""
        scale = self.scale
        train = {seed: scale.survey for r in scale.repetitions for seed in r["train"]}
        test = {seed: {**scale.survey, **scale.test_survey} for r in scale.repetitions for seed in r["test"]}
        return {street_key(seed): {**survey, "seed": seed} for seed, survey in {**train, **test}.items()}

    def sizes_of(self, method: str, patch_size: float | None = None) -> PatchParameters:
        """Return the parameters of the patches of a method, of another size with voxels in proportion."""
        sizes = self.sizes if method in AS_PRINTED else changed(self.sizes, self.scale.patches)
        size = sizes.patch_size if patch_size is None else patch_size
        ratio = sizes.voxel_size / sizes.patch_size
        resized: PatchParameters = changed(sizes, {"patch_size": size, "voxel_size": size * ratio})
        return resized

    def tuning_runs(self) -> list[StudyRun]:
        """Return the runs that settings are chosen by, trained and tested on halves of the first training streets."""
        streets = tuple(self.scale.repetitions[0]["train"])
        half = len(streets) // 2
        return [
            StudyRun(
                f"{method}.setting_{number:02d}", method, streets[:half], streets[half:], self.sizes_of(method),
                {**self.parameters, method: changed(self.parameters[method], setting)},
            )
            for method, settings in self.scale.tuning.items()
            for number, setting in enumerate(settings)
        ]  # fmt: skip

    def tuned(self, tried: Mapping[str, RunResult]) -> dict[str, Any]:
        """Return the parameters of all methods with the best setting of each."""
        best = dict(self.parameters)
        scores: dict[str, float] = {}
        for run in self.tuning_runs():
            score = self.tuning_score(run, tried[run.key]["matrices"])
            if score > scores.get(run.method, -np.inf):
                scores[run.method], best[run.method] = score, run.parameters[run.method]
        return best

    def tuning_score(self, run: StudyRun, matrices: Mapping[str, NDArray[np.int64]]) -> float:
        """Return the mean F1 of a tuning run over the classes that the method can predict; after refinement, if any."""
        total = matrices[REFINES.get(run.method, run.method)].sum(axis=0)
        scores = repetition_scores({"": {run.method: total}}, classes=self.scheme.classes)
        mean = "mean of five" if run.method == "shape_based" else "mean of seven"
        return float(scores.set_index(["class", "metric"])["value"][mean, "f1"])

    def counted_keys(self) -> list[str]:
        """Return the keys of the patches of all streets of the comparison."""
        seeds = [seed for r in self.scale.repetitions for seed in (*r["train"], *r["test"])]
        return [patches_key(seed, self.sizes) for seed in seeds]

    def comparison_runs(self, parameters: Mapping[str, Any]) -> list[StudyRun]:
        """Return the runs of Table III."""
        runs = [
            self._run(number, method, parameters) for number in range(len(self.scale.repetitions)) for method in RUNS
        ]
        first = [replace(run, pictured=True) for run in runs[: len(RUNS)]]
        return [*first, *runs[len(RUNS) :]]

    def size_runs(self, parameters: Mapping[str, Any]) -> dict[float, list[StudyRun]]:
        """Return the runs of Figures 7 and 8, by patch size."""
        return {
            size: [self._run(number, GRAPH, parameters, size) for number in self._sensitive()]
            for size in self.scale.patch_sizes
        }

    def radius_runs(self, parameters: Mapping[str, Any]) -> dict[float, list[StudyRun]]:
        """Return the runs of Figures 9 to 11, by local search radius, with the search of the paper."""
        thinned = {"max_patches": self.scale.radius_patches}
        searches = {
            radius: changed(parameters[PRINTED], {**thinned, "search": {"search_radius": radius}})
            for radius in self.scale.search_radii
        }
        return {
            radius: [self._run(number, PRINTED, {**parameters, PRINTED: search}) for number in self._sensitive()]
            for radius, search in searches.items()
        }

    def _sensitive(self) -> range:
        return range(min(self.scale.sensitivity, len(self.scale.repetitions)))

    def all_runs(self, parameters: Mapping[str, Any]) -> dict[str, StudyRun]:
        """Return every run once, by its key; a run of the comparison stands for an equal one of a figure."""
        runs = [
            *(run for runs in self.size_runs(parameters).values() for run in runs),
            *(run for runs in self.radius_runs(parameters).values() for run in runs),
            *self.comparison_runs(parameters),
        ]
        return {run.key: run for run in runs}

    def _run(
        self, number: int, method: str, parameters: Mapping[str, Any], patch_size: float | None = None
    ) -> StudyRun:
        repetition, used = self.scale.repetitions[number], self.sizes_of(method, patch_size)
        key = f"repetition_{number}.{method}.size_{used.patch_size:g}"
        own = [method]
        if method in REFINES:
            own.append(REFINES[method])
            graph = parameters[method]
            key += f".radius_{graph.search.search_radius:g}.patches_{graph.max_patches}"
        mine = {slug: parameters[slug] for slug in own}
        train, test = tuple(repetition["train"]), tuple(repetition["test"])
        return StudyRun(key, method, train, test, used, mine)


def plan_study(
    study: StudyParameters,
    classes: Mapping[str, Any],
    ground_removal: GroundParameters,
    patches: PatchParameters,
    **methods: Any,
) -> StudyPlan:
    """Return the plan with the changes of the scale."""
    scheme = find_scheme(classes["schemes"], study.scheme)
    changes = study.chosen_scale().methods
    untuned = method_parameters(methods)
    parameters = method_parameters(methods, changes)
    for printed, method in PRINTED_BASELINES.items():
        parameters[printed] = changed(untuned[method], changes.get(printed, {}))
    return StudyPlan(study, scheme, ground_removal, patches, parameters)


def cut_streets(plan: StudyPlan, streets: SceneCollection) -> dict[str, SceneTask]:
    """Create one task per street and patch size that cuts patches."""
    runs = [*plan.tuning_runs(), *plan.all_runs(plan.parameters).values()]
    cuts = {patches_key(seed, run.sizes): (seed, run.sizes) for run in runs for seed in (*run.train, *run.test)}
    return {
        key: SceneTask(cut_patches, {"points": streets[street_key(seed)]}, {"sizes": sizes, "scheme": plan.scheme})
        for key, (seed, sizes) in cuts.items()
    }


def try_settings(plan: StudyPlan, streets: SceneCollection, cut: SceneCollection) -> dict[str, SceneTask]:
    """Create one task per method and setting to try on training streets."""
    return {run.key: _run_task(plan, run, streets, cut) for run in plan.tuning_runs()}


def run_methods(
    plan: StudyPlan, streets: SceneCollection, cut: SceneCollection, tried: SceneCollection
) -> dict[str, SceneTask]:
    """Create one task per run of Table III and of the sensitivity figures, with the best settings."""
    runs = plan.all_runs(plan.tuned(tried.load_all()))
    return {key: _run_task(plan, run, streets, cut) for key, run in runs.items()}


def _run_task(plan: StudyPlan, run: StudyRun, streets: SceneCollection, cut: SceneCollection) -> SceneTask:
    patches, labels = cut.part("patches"), cut.part("labels")

    def inputs(seeds: tuple[int, ...]) -> dict[str, Any]:
        keys = {street_key(seed): patches_key(seed, run.sizes) for seed in seeds}
        return {
            street: {"points": streets[street], "patches": patches[key], "labels": labels[key]}
            for street, key in keys.items()
        }

    return SceneTask(
        train_and_score,
        {"train": inputs(run.train), "test": inputs(run.test)},
        {
            "method": run.method,
            "parameters": dict(run.parameters),
            "stages": PatchStages(plan.ground, run.sizes),
            "scheme": plan.scheme,
            "pictured": run.pictured,
        },
    )
