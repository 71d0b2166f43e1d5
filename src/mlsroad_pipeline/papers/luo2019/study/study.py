"""Study of Luo et al. 2019: its plan, and its page with the paper's results beside ours."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.classes import find_scheme
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.execution.task import SceneTask, SourceFile
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import JointNetParameters
from mlsroad_pipeline.papers.luo2019.pointnet.parameters import PointNetParameters
from mlsroad_pipeline.papers.luo2019.study.figures import CAPTIONS, study_figures
from mlsroad_pipeline.papers.luo2019.study.plan import (
    BASELINES,
    COMBINED,
    JOINTNET,
    PRINTED,
    SYDNEY,
    TUNED,
    StudyParameters,
    StudyPlan,
    measure_networks,
    run_methods,
)
from mlsroad_pipeline.papers.luo2019.study.results import study_tables
from mlsroad_pipeline.papers.luo2019.study.sets import SimulatedObjectsParameters
from mlsroad_pipeline.papers.shared.recognition.descriptor_machine import DescriptorParameters
from mlsroad_pipeline.papers.shared.recognition.object_set import find_folds, listed_files, read_fold
from mlsroad_pipeline.papers.shared.studies.study import Shown, Stage, Study, Tables

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


def study_facts(plan: StudyPlan) -> dict[str, Any]:
    """Return the settings of the runs."""
    scale = plan.scale
    return {
        "scale": plan.study.scale,
        "seeds of the methods": ", ".join(map(str, scale.seeds)),
        **{
            f"{COMBINED}={i}": f"noise, share kept, outliers, occlusion {list(v)}"
            for i, v in enumerate(scale.combined, 1)
        },
        "Figures 7, 13 and 14": f"jointnet with {dict(scale.variants)}" if scale.variants else "jointnet unchanged",
        "Sydney Urban Objects": ", ".join(plan.folds) or "not used",
    }


_TIMES = (
    "CPU time on one thread, batches of 32 objects of 1,000 points. Memory of a training step: weights, gradients, "
    "momenta and tensors stored for the backward pass. The paper's values are of a GPU; its recognition times are "
    "of test sets of about 4,500 and 1,900 objects."
)
PAGE = {
    "table_2": ("Table 2: methods", "Means over classes on undisturbed test objects."),
    "table_3": ("Table 3: Sydney Urban Objects", ""),
    "differences": (
        "Differences from JointNet",
        "Mean F1 of a method minus that of jointnet; 95 % bootstrap intervals of 2,000 samples of test streets.",
    ),
    "table_1": ("Table 1: sub-networks", _TIMES),
    "table_4": ("Table 4: efficiency", _TIMES),
    "image_sizes": ("Figure 7: image sizes", ""),
    "size_grid": ("Combinations of image sizes", ""),
    "robustness": ("Figure 12: disturbed test objects", ""),
    "training": ("Figures 13 and 14: disturbed training objects", ""),
    "tuning": ("Settings tried on validation objects", ""),
}
"""Name of each table of the page to its title and note."""


def study_page(plan: StudyPlan, tables: Tables) -> list[Shown]:
    """Return the tables of the page."""
    return [Shown(title, tables[name], note) for name, (title, note) in PAGE.items()]


STUDY = Study(
    "luo2019",
    "Luo et al. 2019 on simulated objects",
    parameters=("simulated_objects", "classes", JOINTNET, TUNED, PRINTED, *BASELINES),
    plan=plan_study,
    stages=[
        Stage("read_luo2019_folds", read_folds, [], "folds"),
        Stage("measure_luo2019_networks", measure_networks, [], "networks"),
        Stage("run_luo2019_methods", run_methods, ["simulated_objects.sets", "folds"], "runs"),
    ],
    results=["runs", "networks"],
    tables=("scores", "sub_networks", "confusion_counts", "curves", *PAGE),
    tabulate=study_tables,
    captions=CAPTIONS,
    draw=study_figures,
    facts=study_facts,
    page=study_page,
)
