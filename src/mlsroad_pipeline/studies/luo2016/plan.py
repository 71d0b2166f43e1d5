"""Which runs the study of Luo et al. 2016 consists of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.patches.extraction import PatchParameters
from mlsroad_pipeline.algorithms.patches.labelling import PatchStages
from mlsroad_pipeline.algorithms.stages import GroundParameters
from mlsroad_pipeline.studies.luo2016.parameters import (
    GRAPH,
    METHODS,
    REFINED,
    RUNS,
    StudyParameters,
    StudyScale,
)
from mlsroad_pipeline.studies.luo2016.scores import repetition_scores
from mlsroad_pipeline.studies.parameters import changed


@dataclass(frozen=True)
class StudyRun:
    """A method trained on some streets and scored on others.

    Parameters
    ----------
    key : str
        Its name in the store.
    method : str
        One of `RUNS`.
    train, test : tuple of int
        Seeds of the streets.
    sizes : PatchParameters
        How they are cut.
    parameters : mapping of str to dataclass
        Slug to parameters.
    """

    key: str
    method: str
    train: tuple[int, ...]
    test: tuple[int, ...]
    sizes: PatchParameters
    parameters: Mapping[str, Any]


@dataclass(frozen=True)
class StudyPlan:
    """Everything that the stages of the study need to know.

    Parameters
    ----------
    study : StudyParameters
        What is run.
    scheme : ClassScheme
        The classes.
    ground : GroundParameters
        The ground filter.
    sizes : PatchParameters
        The patches.
    parameters : mapping of str to dataclass
        Slug to the parameters of the method, changes of the scale included.
    """

    study: StudyParameters
    scheme: ClassScheme
    ground: GroundParameters
    sizes: PatchParameters
    parameters: Mapping[str, Any]

    @property
    def scale(self) -> StudyScale:
        """Return the scale that is run."""
        return self.study.chosen_scale()

    def stages(self, sizes: PatchParameters) -> PatchStages:
        """Return how streets are prepared with some patches."""
        return PatchStages(self.ground, sizes)

    def surveys(self) -> dict[int, dict[str, Any]]:
        """Return what `simulation_parameters` takes for every street, by seed."""
        scale = self.scale
        train = {seed: {**scale.survey, "seed": seed} for r in scale.repetitions for seed in r["train"]}
        test = {
            seed: {**scale.survey, **scale.test_survey, "seed": seed} for r in scale.repetitions for seed in r["test"]
        }
        return {**train, **test}

    def resized(self, patch_size: float) -> PatchParameters:
        """Return the parameters of larger or smaller patches, with voxels in proportion."""
        ratio = self.sizes.voxel_size / self.sizes.patch_size
        return changed(self.sizes, {"patch_size": patch_size, "voxel_size": patch_size * ratio})

    def tuning_runs(self) -> list[StudyRun]:
        """Return the runs that settings are chosen by: half of the first training streets for each half."""
        streets = tuple(self.scale.repetitions[0]["train"])
        half = len(streets) // 2
        return [
            StudyRun(
                f"{method}.setting_{number:02d}", method, streets[:half], streets[half:], self.sizes,
                {**self.parameters, method: changed(self.parameters[method], setting)},
            )
            for method, settings in self.scale.tuning.items()
            for number, setting in enumerate(settings)
        ]  # fmt: skip

    def tuned(self, tried: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
        """Return the parameters of all methods with the best setting of each."""
        best = dict(self.parameters)
        scores: dict[str, float] = {}
        for run in self.tuning_runs():
            score = self.tuning_score(run, tried[run.key]["matrices"])
            if score > scores.get(run.method, -np.inf):
                scores[run.method], best[run.method] = score, run.parameters[run.method]
        return best

    def tuning_score(self, run: StudyRun, matrices: Mapping[str, NDArray[np.int64]]) -> float:
        """Return the mean F1 of a tuning run over the classes that the method's kind can give."""
        total = matrices[run.method].sum(axis=0)
        found = repetition_scores({"": {run.method: total}}, classes=self.scheme.classes)
        wanted = "mean of five" if run.method == "shape_based" else "mean of seven"
        return float(found.set_index(["class", "metric"])["value"][wanted, "f1"])

    def comparison_runs(self, parameters: Mapping[str, Any]) -> list[StudyRun]:
        """Return the runs of Table III."""
        return [
            self._run(number, method, parameters) for number in range(len(self.scale.repetitions)) for method in RUNS
        ]

    def size_runs(self, parameters: Mapping[str, Any]) -> dict[float, StudyRun]:
        """Return the runs of Figures 7 and 8, by patch size."""
        tests = self.study.sensitivity
        sizes = self.scale.patch_sizes if tests else ()
        return {size: self._run(0, GRAPH, parameters, self.resized(size), tests=tests) for size in sizes}

    def radius_runs(self, parameters: Mapping[str, Any]) -> dict[float, StudyRun]:
        """Return the runs of Figures 9 to 11, by local search radius."""
        tests = self.study.sensitivity
        radii = self.scale.search_radii if tests else ()
        # The search as printed: where it starts in cells of alike descriptions, the radius has little left to decide.
        searches = {
            radius: changed(parameters[GRAPH], {"search": {"search_radius": radius, "n_probes": 0}}) for radius in radii
        }
        return {
            radius: self._run(0, GRAPH, {**parameters, GRAPH: search}, tests=tests)
            for radius, search in searches.items()
        }

    def all_runs(self, parameters: Mapping[str, Any]) -> dict[str, StudyRun]:
        """Return every run once, by its key."""
        runs = [
            *self.comparison_runs(parameters),
            *self.size_runs(parameters).values(),
            *self.radius_runs(parameters).values(),
        ]
        return {run.key: run for run in runs}

    def _run(
        self,
        number: int,
        method: str,
        parameters: Mapping[str, Any],
        sizes: PatchParameters | None = None,
        *,
        tests: int | None = None,
    ) -> StudyRun:
        repetition, used = self.scale.repetitions[number], sizes or self.sizes
        streets = tuple(repetition["test"])[:tests]
        own = [method, REFINED] if method == GRAPH else [method]
        key = f"repetition_{number}.{method}.tests_{len(streets)}.size_{used.patch_size:g}"
        if method == GRAPH:
            key += f".radius_{parameters[GRAPH].search.search_radius:g}.probes_{parameters[GRAPH].search.n_probes}"
        mine = {slug: parameters[slug] for slug in own}
        return StudyRun(key, method, tuple(repetition["train"]), streets, used, mine)


def plan_study(
    study: StudyParameters,
    *,
    scheme: ClassScheme,
    ground: GroundParameters,
    sizes: PatchParameters,
    methods: Mapping[str, Any],
) -> StudyPlan:
    """Plan the study."""
    changes = study.chosen_scale().methods
    parameters = {slug: changed(methods[slug], changes.get(slug, {})) for slug in METHODS}
    return StudyPlan(study, scheme, ground, sizes, parameters)
