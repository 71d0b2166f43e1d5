"""Runs of the study of Luo et al. 2019 and their tasks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.models import methods as method_table
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.papers.luo2019.study import runs
from mlsroad_pipeline.papers.luo2019.study.parameters import (
    BASELINES,
    CLEAN,
    JOINTNET,
    METHODS,
    SUB_NETWORKS,
    StudyParameters,
    StudyScale,
    seeded,
)
from mlsroad_pipeline.papers.shared.recognition.disturbances import PAPER_LEVELS, Disturbance
from mlsroad_pipeline.papers.shared.studies.parameters import changed

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
