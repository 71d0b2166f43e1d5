"""Scales, disturbances, settings and runs of the study of Luo et al. 2019, and their tasks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.models import methods as method_table
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import VIEWS
from mlsroad_pipeline.papers.luo2019.study import runs
from mlsroad_pipeline.papers.shared.recognition.disturbances import PAPER_LEVELS, Disturbance
from mlsroad_pipeline.papers.shared.studies.parameters import ScaledStudy, changed

JOINTNET, TUNED, PRINTED = "jointnet", "jointnet_tuned", "jointnet_printed"
SUB_NETWORKS = tuple(f"{view}_net" for view in VIEWS)
BASELINES = ("hierarchy_descriptor", "spin_image", "shot", "pointnet")
METHODS = (JOINTNET, TUNED, PRINTED, *SUB_NETWORKS, *BASELINES)
"""All recognisers; the baselines in the order of the paper's Table 2."""

KINDS = ("noise", "keep", "outliers", "occlusion")
"""Disturbances in the order of Figures 12 and 13; `keep` is the share of points kept by down-sampling."""

CLEAN, LABELS, COMBINED = "clean", "labels", "combined"


@dataclass(frozen=True)
class StudyScale:
    """Levels and settings of one scale."""

    # Seeds of the methods. All methods are trained once per seed; the counts of all seeds are summed.
    seeds: Sequence[int]
    # Image sizes of Figure 7, each tried for one kind of image while the others keep theirs (luo2019: 8 to 256).
    # Computing time grows with the square of the size.
    sizes: Sequence[int]
    # noise, keep, outliers, occlusion: levels of test objects in Figure 12
    noise: Sequence[float]
    keep: Sequence[float]
    outliers: Sequence[float]
    occlusion: Sequence[float]
    # Levels of training objects in Figure 13, by kind; ``labels`` are shares of wrong classes (Figure 14c, luo2019:
    # 1/32 to 8/32)
    training: Mapping[str, Sequence[float]]
    # Noise, share of points kept, outliers and occlusion of training objects in Figures 14a and 14b. The paper gives
    # the first, (0.01, 0.5, 0.05, 0.05).
    combined: Sequence[Sequence[float]]
    variants: Mapping[str, Any]  # Changes of JointNet's parameters for Figures 7, 13 and 14, which take many trainings
    # Changes of the parameters of JointNet and its sub-networks for Figures 9 and 10, where images alone are used
    images_alone: Mapping[str, Any]
    # Image sizes of which all combinations for the three kinds of images are tried; empty for none. The paper tries 6 x
    # 6 x 6 = 216 (section 4.2).
    grid: Sequence[int]
    methods: Mapping[str, Mapping[str, Any]]  # Slug to changes of the method's parameters at this scale
    # Slug to the settings to try; the one with the highest accuracy on validation objects is used. Methods without
    # settings here use their parameters or choose by cross-validation.
    tuning: Mapping[str, Sequence[Mapping[str, Any]]]

    def __post_init__(self) -> None:
        if not self.seeds:
            raise ParameterError("luo2019_study: seeds must not be empty")
        unknown = sorted({*self.methods, *self.tuning} - set(METHODS))
        if unknown:
            raise ParameterError(f"luo2019_study: unknown methods {unknown} (methods: {', '.join(METHODS)})")
        unknown = sorted(set(self.training) - {*KINDS, LABELS})
        if unknown:
            raise ParameterError(f"luo2019_study.training: unknown {unknown} (kinds: {', '.join((*KINDS, LABELS))})")
        for rate in self.training.get(LABELS, ()):
            if not 0 <= rate < 1:
                raise ParameterError(f"luo2019_study.training.labels must be at least 0 and below 1, got {rate!r}")
        self.conditions()
        self.training_conditions()

    def conditions(self) -> dict[str, Disturbance]:
        """Return the disturbances of test objects by name, such as ``noise=0.02``."""
        fixed = {CLEAN: Disturbance(), **{f"level={i}": level for i, level in enumerate(PAPER_LEVELS, 1)}}
        return fixed | {f"{kind}={v:g}": Disturbance(**{kind: v}) for kind in KINDS for v in getattr(self, kind)}

    def training_conditions(self) -> dict[str, tuple[Disturbance, float]]:
        """Return the disturbances of training objects by name, each with its share of wrong classes."""
        conditions = {CLEAN: (Disturbance(), 0.0)}
        for kind, levels in self.training.items():
            for v in levels:
                wrong = kind == LABELS
                conditions[f"{kind}={v:g}"] = (
                    Disturbance() if wrong else Disturbance(**{kind: v}),
                    v if wrong else 0.0,
                )
        for i, values in enumerate(self.combined, 1):
            if len(values) != len(KINDS):
                raise ParameterError(f"luo2019_study.combined must have four numbers each, got {list(values)}")
            conditions[f"{COMBINED}={i}"] = (Disturbance(**dict(zip(KINDS, values, strict=True))), 0.0)
        return conditions

    def size_settings(self, sizes: Sequence[int]) -> dict[str, list[int]]:
        """Return the settings of Figure 7."""
        return {
            f"{view}={size}": [size if k == i else int(kept) for k, kept in enumerate(sizes)]
            for i, view in enumerate(VIEWS)
            for size in self.sizes
        }

    def grid_settings(self) -> dict[str, list[int]]:
        """Return the combinations of image sizes, such as ``sizes=16x8x16``."""
        return {"sizes=" + "x".join(map(str, sizes)): list(sizes) for sizes in product(self.grid, repeat=len(VIEWS))}


@dataclass(frozen=True)
class StudyParameters(ScaledStudy[StudyScale], group="luo2019_study", kind=StudyScale):
    """Parameters of the study of Luo et al. 2019."""

    # Folder of the Sydney Urban Objects, whose folds are also recognised (Tables 2 and 3, Figures 11c and 12i to 12l);
    # None omits them
    sydney: str | None
    seed: int  # Seed of the disturbances, which are the same for all methods


def seeded(parameters: Any, seed: int) -> Any:
    """Return a method's parameters with another seed."""
    if hasattr(parameters, "training"):
        return replace(parameters, training=replace(parameters.training, seed=seed))
    return replace(parameters, seed=seed)


SYDNEY = "sydney"
MAIN, SIZE, TRAINING = "main", "size", "training"
"""Groups of runs: all methods; Figure 7; Figures 13 and 14."""

ALONE, GRID = "alone", "grid"
"""Groups of runs: networks without the measures (Figures 9 and 10); combinations of image sizes."""

PUBLISHED = "pointnet_published"
PUBLISHED_POINTNET = {"n_points": 1024, "widths": [64, 128, 1024], "hidden": [512, 256]}
"""Size of PointNet in Qi et al. 2017."""

PAPER_LEVEL = {f"level={i}": level for i, level in enumerate(PAPER_LEVELS, 1)}
"""Test sets 1, 2 and 3 of the paper."""

UNDISTURBED = Disturbance()


@dataclass(frozen=True)
class StudyRun:
    """Training of one method on one set."""

    group: str  # `MAIN`, `ALONE`, `SIZE`, `GRID` or `TRAINING`
    dataset: str  # set of objects
    setting: str  # run within the group: the method, the image size, or the disturbance of the training objects
    method: str  # recogniser
    settings: tuple[Any, ...]  # parameters to try; those with the highest accuracy on validation objects are used
    train: tuple[str, ...]  # keys of the training objects
    test: str  # key of the test objects
    conditions: Mapping[str, Disturbance]  # disturbances of the test objects by name
    seed: int  # seed of the method
    validation: str | None = None  # key of the validation objects; None where there is one setting
    disturbance: Disturbance = UNDISTURBED  # disturbance of the training objects
    wrong_labels: float = 0.0  # share of training objects with a wrong class

    @property
    def key(self) -> str:
        """Return the key of the run in the store."""
        name = self.setting.replace("=", "-").replace(".", "_")
        return f"{self.group}.{self.test}.{name}.seed_{self.seed}"


@dataclass(frozen=True)
class StudyPlan:
    """Parameters of the study, and the runs that follow from them."""

    study: StudyParameters  # scale, seed and folder of the Sydney Urban Objects
    sets: tuple[str, ...]  # simulated sets
    schemes: Mapping[str, ClassScheme]  # classes of each set
    folds: Mapping[str, str]  # fold of the Sydney Urban Objects to the file that lists its objects; empty without them
    methods: Mapping[str, Any]  # slug to parameters

    @property
    def scale(self) -> StudyScale:
        """Return the scale that is run."""
        return self.study.chosen_scale()

    def runs(self) -> dict[str, StudyRun]:
        """Return all runs by their keys."""
        every = [
            *(self._main(name, method, seed) for name in self.sets for method in METHODS for seed in self.scale.seeds),
            *(self._fold(fold, m, seed) for fold in self.folds for m in METHODS for seed in self.scale.seeds),
            *self._alone(),
            *self._sizes(SIZE, self.scale.size_settings(self._variant().inputs.sizes)),
            *self._sizes(GRID, self.scale.grid_settings()),
            *(self._training(name, setting) for name in self.sets for setting in self.scale.training_conditions()),
        ]
        return {run.key: run for run in every}

    def of_group(self, group: str) -> list[StudyRun]:
        """Return the runs of a group."""
        return [run for run in self.runs().values() if run.group == group]

    def _settings(self, method: str, seed: int) -> tuple[Any, ...]:
        own = changed(self.methods[method], self.scale.methods.get(method, {}))
        tried: Sequence[Mapping[str, Any]] = self.scale.tuning.get(method, [{}])
        return tuple(seeded(changed(own, changes), seed) for changes in tried)

    def _main(self, name: str, method: str, seed: int) -> StudyRun:
        settings = self._settings(method, seed)
        validation = f"{name}.validation" if len(settings) > 1 else None
        return StudyRun(
            MAIN, name, method, method, settings, (f"{name}.train",), f"{name}.test", self.scale.conditions(), seed,
            validation,
        )  # fmt: skip

    def _fold(self, fold: str, method: str, seed: int) -> StudyRun:
        others = tuple(f"{SYDNEY}.{other}" for other in self.folds if other != fold)
        return StudyRun(
            MAIN, SYDNEY, method, method, self._settings(method, seed)[:1], others, f"{SYDNEY}.{fold}",
            self.scale.conditions(), seed,
        )  # fmt: skip

    def _variant(self) -> Any:
        return changed(self._settings(JOINTNET, self.scale.seeds[0])[0], self.scale.variants)

    def _alone(self) -> list[StudyRun]:
        name, conditions = self.sets[0], {CLEAN: UNDISTURBED, **PAPER_LEVEL}
        return [
            StudyRun(
                ALONE, name, method, method, (changed(self._settings(method, seed)[0], self.scale.images_alone),),
                (f"{name}.train",), f"{name}.test", conditions, seed,
            )
            for method in (JOINTNET, *SUB_NETWORKS)
            for seed in self.scale.seeds
        ]  # fmt: skip

    def _sizes(self, group: str, sizes: Mapping[str, Sequence[int]]) -> list[StudyRun]:
        base, name = self._variant(), self.sets[0]
        return [
            StudyRun(
                group, name, setting, JOINTNET, (changed(base, {"inputs": {"sizes": list(each)}}),), (f"{name}.train",),
                f"{name}.test", PAPER_LEVEL, self.scale.seeds[0],
            )
            for setting, each in sizes.items()
        ]  # fmt: skip

    def _training(self, name: str, setting: str) -> StudyRun:
        disturbance, wrong = self.scale.training_conditions()[setting]
        return StudyRun(
            TRAINING, name, setting, JOINTNET, (self._variant(),), (f"{name}.train",), f"{name}.test",
            {CLEAN: Disturbance()}, self.scale.seeds[0], disturbance=disturbance, wrong_labels=wrong,
        )  # fmt: skip

    def networks(self) -> dict[str, Any]:
        """Return the networks of Tables 1 and 4: method to parameters; PointNet also in its published size."""
        pointnet = BASELINES[-1]
        own = {name: self._settings(name, self.scale.seeds[0])[0] for name in (JOINTNET, *SUB_NETWORKS, pointnet)}
        return {**own, PUBLISHED: changed(own[pointnet], PUBLISHED_POINTNET)}


def measure_networks(plan: StudyPlan) -> dict[str, SceneTask]:
    """Create one task per network that measures size, memory and time."""
    n_classes = len(plan.schemes[plan.sets[0]])

    def task(method: str, parameters: Any) -> SceneTask:
        view = method_table.METHODS[method].variant if method in method_table.METHODS else None
        own = parameters.with_views(view) if view else parameters
        return SceneTask(runs.measure_network, parameters={"parameters": own, "n_classes": n_classes})

    return {method: task(method, parameters) for method, parameters in plan.networks().items()}


def run_methods(plan: StudyPlan, sets: SceneCollection, folds: SceneCollection) -> dict[str, SceneTask]:
    """Create one task per run that trains a method and recognises test objects."""

    def task(run: StudyRun) -> SceneTask:
        store = folds if run.dataset == SYDNEY else sets
        inputs: dict[str, Any] = {"train": {key: store[key] for key in run.train}, "test": store[run.test]}
        if run.validation is not None:
            inputs["validation"] = store[run.validation]
        return SceneTask(
            runs.train_and_recognise,
            inputs,
            {
                "method": run.method,
                "settings": list(run.settings),
                "conditions": dict(run.conditions),
                "disturbance": run.disturbance,
                "wrong_labels": run.wrong_labels,
                "n_classes": len(plan.schemes[run.dataset]),
                "seed": plan.study.seed,
            },
        )

    return {key: task(run) for key, run in plan.runs().items()}
