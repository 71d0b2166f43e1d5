"""Nodes of the study of Luo et al. 2019; the other stages are in `studies.luo2019.plan`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.classes import find_scheme
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask, SourceFile
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import JointNetParameters
from mlsroad_pipeline.papers.luo2019.pointnet.parameters import PointNetParameters
from mlsroad_pipeline.papers.luo2019.study.parameters import BASELINES, JOINTNET, PRINTED, TUNED, StudyParameters
from mlsroad_pipeline.papers.luo2019.study.plan import SYDNEY, StudyPlan
from mlsroad_pipeline.papers.luo2019.study.results import StudyTables, study_tables
from mlsroad_pipeline.papers.luo2019.study.set_parameters import SimulatedObjectsParameters
from mlsroad_pipeline.papers.shared.recognition.descriptor_machine import DescriptorParameters
from mlsroad_pipeline.papers.shared.recognition.object_set import find_folds, listed_files, read_fold

FOLDS, SYDNEY_SCHEME = "folds/fold*.txt", "sydney14"


def plan_study(
    study: StudyParameters,
    sets: SimulatedObjectsParameters,
    classes: Mapping[str, Any],
    jointnet: JointNetParameters,
    tuned: JointNetParameters,
    printed: JointNetParameters,
    hierarchy: DescriptorParameters,
    spin: DescriptorParameters,
    shot: DescriptorParameters,
    pointnet: PointNetParameters,
) -> StudyPlan:
    """Plan the runs."""
    methods: dict[str, Any] = {
        JOINTNET: jointnet,
        TUNED: tuned,
        PRINTED: printed,
        **{slug: jointnet for slug, known in METHODS.items() if known.variant},
    }
    methods |= dict(zip(BASELINES, (hierarchy, spin, shot, pointnet), strict=True))
    names = tuple(sets.chosen_sets())
    schemes = {name: find_scheme(classes["schemes"], name) for name in names}
    folds = {} if study.sydney is None else {n: str(p) for n, p in find_folds(study.sydney, FOLDS).items()}
    if folds:
        schemes[SYDNEY] = find_scheme(classes["schemes"], SYDNEY_SCHEME)
    return StudyPlan(study, names, schemes, folds, methods)


def read_folds(plan: StudyPlan) -> dict[str, SceneTask]:
    """Create one task per fold of the Sydney Urban Objects that reads it."""
    return {
        f"{SYDNEY}.{name}": SceneTask(
            read_fold,
            {"path": SourceFile(path), "files": [SourceFile(str(file)) for file in listed_files(Path(path))]},
            {"scheme": plan.schemes[SYDNEY]},
        )
        for name, path in plan.folds.items()
    }


def tabulate_study(plan: StudyPlan, runs: SceneCollection, networks: SceneCollection) -> StudyTables:
    """Make the tables."""
    return study_tables(plan, runs.load_all("results"), runs.load_all("facts"), networks.load_all())
