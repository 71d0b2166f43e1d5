"""The runs of the study of Luo et al. 2019: which method learns from what, and what it recognises."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.recognition.disturbances import PAPER_LEVELS, Disturbance
from mlsroad_pipeline.studies.luo2019.parameters import (
    CLEAN,
    JOINTNET,
    METHODS,
    RIVALS,
    SUB_NETWORKS,
    StudyParameters,
    StudyScale,
    seeded,
)
from mlsroad_pipeline.studies.parameters import changed

SYDNEY = "sydney"
MAIN, SIZE, TRAINING = "main", "size", "training"
"""Groups of runs: all methods; Figure 7; Figures 13 and 14."""


@dataclass(frozen=True)
class StudyRun:
    """One method trained on one set.

    Parameters
    ----------
    group : str
        `MAIN`, `SIZE` or `TRAINING`.
    dataset : str
        The set.
    setting : str
        Which of the group's: the method, the image size, or how the training objects are disturbed.
    method : str
        The recogniser.
    settings : tuple of dataclass
        Its parameters; of several the one with the highest accuracy on validation objects is taken.
    train : tuple of str
        What it learns from.
    validation : str or None
        What settings are chosen by.
    test : str
        What it recognises.
    conditions : mapping of str to Disturbance
        How these are disturbed.
    disturbance : Disturbance
        How the training objects are disturbed.
    wrong_labels : float
        Share of the training objects that have a wrong class.
    seed : int
        Seed of the method.
    """

    group: str
    dataset: str
    setting: str
    method: str
    settings: tuple[Any, ...]
    train: tuple[str, ...]
    validation: str | None
    test: str
    conditions: Mapping[str, Disturbance]
    disturbance: Disturbance
    wrong_labels: float
    seed: int

    @property
    def key(self) -> str:
        """Name of the run, as a store can hold it."""
        name = self.setting.replace("=", "-").replace(".", "_")
        return f"{self.group}.{self.test}.{name}.seed_{self.seed}"


@dataclass(frozen=True)
class StudyPlan:
    """What the study runs.

    Parameters
    ----------
    study : StudyParameters
        What is run.
    scale : StudyScale
        How large.
    sets : tuple of str
        The simulated sets.
    schemes : mapping of str to ClassScheme
        Set to its classes.
    folds : mapping of str to str
        Fold of the Sydney Urban Objects to the file that lists its objects; empty without them.
    methods : mapping
        Slug to parameters.
    """

    study: StudyParameters
    scale: StudyScale
    sets: tuple[str, ...]
    schemes: Mapping[str, ClassScheme]
    folds: Mapping[str, str]
    methods: Mapping[str, Any]

    def runs(self) -> dict[str, StudyRun]:
        """Return all runs by their keys."""
        found = [
            *(self._main(name, method, seed) for name in self.sets for method in METHODS for seed in self.scale.seeds),
            *(self._fold(fold, m, seed) for fold in self.folds for m in METHODS for seed in self.scale.seeds),
            *self._sizes(),
            *(self._training(name, setting) for name in self.sets for setting in self.scale.training_conditions()),
        ]
        return {run.key: run for run in found}

    def of_group(self, group: str) -> list[StudyRun]:
        """Return the runs of a group."""
        return [run for run in self.runs().values() if run.group == group]

    def _settings(self, method: str, seed: int) -> tuple[Any, ...]:
        own = changed(self.methods[method], self.scale.methods.get(method, {}))
        tried: Sequence[Mapping[str, Any]] = self.scale.tuning.get(method, [{}])
        return tuple(seeded(changed(own, changes), seed) for changes in tried)

    def _main(self, name: str, method: str, seed: int) -> StudyRun:
        settings = self._settings(method, seed)
        return StudyRun(
            MAIN, name, method, method, settings, (f"{name}.train",),
            f"{name}.validation" if len(settings) > 1 else None, f"{name}.test", self.scale.conditions(),
            Disturbance(), 0.0, seed,
        )  # fmt: skip

    def _fold(self, fold: str, method: str, seed: int) -> StudyRun:
        others = tuple(f"{SYDNEY}.{other}" for other in self.folds if other != fold)
        return StudyRun(
            MAIN, SYDNEY, method, method, self._settings(method, seed)[:1], others, None, f"{SYDNEY}.{fold}",
            self.scale.conditions(), Disturbance(), 0.0, seed,
        )  # fmt: skip

    def _variant(self) -> Any:
        return changed(self._settings(JOINTNET, self.scale.seeds[0])[0], self.scale.variants)

    def _sizes(self) -> list[StudyRun]:
        base, name = self._variant(), self.sets[0]
        levels = {f"level={i}": level for i, level in enumerate(PAPER_LEVELS, 1)}
        settings: dict[str, Any] = {
            setting: changed(base, {"inputs": {"sizes": sizes}})
            for setting, sizes in self.scale.size_settings(base.inputs.sizes).items()
        }
        return [
            StudyRun(
                SIZE, name, setting, JOINTNET, (parameters,), (f"{name}.train",), None, f"{name}.test", levels,
                Disturbance(), 0.0, self.scale.seeds[0],
            )
            for setting, parameters in settings.items()
        ]  # fmt: skip

    def _training(self, name: str, setting: str) -> StudyRun:
        disturbance, wrong = self.scale.training_conditions()[setting]
        return StudyRun(
            TRAINING, name, setting, JOINTNET, (self._variant(),), (f"{name}.train",), None, f"{name}.test",
            {CLEAN: Disturbance()}, disturbance, wrong, self.scale.seeds[0],
        )  # fmt: skip

    def networks(self) -> dict[str, Any]:
        """Return the networks of Tables 1 and 4: method to parameters."""
        return {
            method: self._settings(method, self.scale.seeds[0])[0]
            for method in METHODS
            if method in (JOINTNET, *SUB_NETWORKS) or method == RIVALS[-1]
        }
