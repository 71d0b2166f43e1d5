"""The study of Luo et al. 2019, stage by stage."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.baselines.pointnet.parameters import PointNetParameters
from mlsroad_pipeline.algorithms.evaluation.labelling import find_scheme
from mlsroad_pipeline.algorithms.jointnet.parameters import JointNetParameters
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.algorithms.recognition.descriptor_machine import DescriptorParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile
from mlsroad_pipeline.studies.luo2019 import runs as luo2019_runs
from mlsroad_pipeline.studies.luo2019.parameters import JOINTNET, PRINTED, RIVALS, StudyParameters
from mlsroad_pipeline.studies.luo2019.plan import SYDNEY, StudyPlan, StudyRun
from mlsroad_pipeline.studies.luo2019.results import study_tables
from mlsroad_pipeline.studies.luo2019.set_parameters import SimulatedObjectsParameters
from mlsroad_pipeline.surveys.object_files import find_folds, listed_files, read_fold

FOLDS, SYDNEY_SCHEME = "folds/fold*.txt", "sydney14"


def plan_study(
    study: StudyParameters,
    sets: SimulatedObjectsParameters,
    classes: Mapping[str, Any],
    jointnet: JointNetParameters,
    printed: JointNetParameters,
    hierarchy: DescriptorParameters,
    spin: DescriptorParameters,
    shot: DescriptorParameters,
    pointnet: PointNetParameters,
) -> StudyPlan:
    """Plan the runs."""
    methods: dict[str, Any] = {
        JOINTNET: jointnet,
        PRINTED: printed,
        **{slug: jointnet for slug, known in METHODS.items() if known.variant},
    }
    methods |= dict(zip(RIVALS, (hierarchy, spin, shot, pointnet), strict=True))
    names = tuple(sets.chosen_sets())
    schemes = {name: find_scheme(classes["schemes"], name) for name in names}
    folds = {} if study.sydney is None else {n: str(p) for n, p in find_folds(study.sydney, FOLDS).items()}
    if folds:
        schemes[SYDNEY] = find_scheme(classes["schemes"], SYDNEY_SCHEME)
    return StudyPlan(study, study.chosen_scale(), names, schemes, folds, methods)


def read_folds(plan: StudyPlan) -> dict[str, SceneTask]:
    """Name the work that reads the folds of the Sydney Urban Objects."""
    return {
        f"{SYDNEY}.{name}": SceneTask(
            read_fold,
            {"path": SourceFile(path), "files": [SourceFile(str(file)) for file in listed_files(Path(path))]},
            {"scheme": plan.schemes[SYDNEY]},
        )
        for name, path in plan.folds.items()
    }


def measure_networks(plan: StudyPlan) -> dict[str, SceneTask]:
    """Name the work that measures size, memory and time of each network."""
    n_classes = len(plan.schemes[plan.sets[0]])
    return {
        method: SceneTask(
            luo2019_runs.measure_network,
            parameters={
                "parameters": parameters.with_views(METHODS[method].variant) if METHODS[method].variant else parameters,
                "n_classes": n_classes,
            },
        )
        for method, parameters in plan.networks().items()
    }


def run_methods(plan: StudyPlan, sets: SceneCollection, folds: SceneCollection) -> dict[str, SceneTask]:
    """Name the work that trains each method and lets it recognise objects."""

    def task(run: StudyRun) -> SceneTask:
        store = folds if run.dataset == SYDNEY else sets
        inputs: dict[str, Any] = {"train": {key: store[key] for key in run.train}, "test": store[run.test]}
        if run.validation is not None:
            inputs["validation"] = store[run.validation]
        return SceneTask(
            luo2019_runs.train_and_recognise,
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


def tabulate_study(plan: StudyPlan, runs: SceneCollection, networks: SceneCollection) -> tuple[Any, ...]:
    """Make the tables of the study."""
    results, facts = runs.part("results").load_all(), runs.part("facts").load_all()
    return study_tables(plan, results, facts, networks.load_all()).as_tuple()
