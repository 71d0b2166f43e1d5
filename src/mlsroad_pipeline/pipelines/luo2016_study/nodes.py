"""The study of Luo et al. 2016, stage by stage."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mlsroad_pipeline.algorithms.baselines.max_margin_markov.training import MarginParameters
from mlsroad_pipeline.algorithms.baselines.patch_forest.classifier import PatchForestParameters
from mlsroad_pipeline.algorithms.baselines.patch_svm.classifier import PatchSvmParameters
from mlsroad_pipeline.algorithms.baselines.shape_based.labeller import ShapeParameters
from mlsroad_pipeline.algorithms.evaluation.labelling import find_scheme
from mlsroad_pipeline.algorithms.patch_graph.classifier import PatchGraphParameters
from mlsroad_pipeline.algorithms.patch_graph.refined_classifier import GridParameters
from mlsroad_pipeline.algorithms.patches.extraction import PatchParameters
from mlsroad_pipeline.algorithms.stages import GroundParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.pipelines.study import street_tasks
from mlsroad_pipeline.studies.luo2016 import plan as luo2016_plan
from mlsroad_pipeline.studies.luo2016.parameters import METHODS, StudyParameters
from mlsroad_pipeline.studies.luo2016.plan import StudyPlan, StudyRun
from mlsroad_pipeline.studies.luo2016.results import study_tables
from mlsroad_pipeline.studies.luo2016.runs import cut_patches, train_and_score
from mlsroad_pipeline.studies.streets import make_street


def plan_study(
    study: StudyParameters,
    classes: Mapping[str, Any],
    ground: GroundParameters,
    sizes: PatchParameters,
    svm: PatchSvmParameters,
    forest: PatchForestParameters,
    shapes: ShapeParameters,
    network: MarginParameters,
    graph: PatchGraphParameters,
    refinement: GridParameters,
) -> StudyPlan:
    """Plan the runs."""
    scheme = find_scheme(classes["schemes"], study.scheme)
    given = dict(zip(METHODS, (svm, forest, shapes, network, graph, refinement), strict=True))
    return luo2016_plan.plan_study(study, scheme=scheme, ground=ground, sizes=sizes, methods=given)


def _street(seed: int) -> str:
    return f"seed_{seed}"


def _cut(seed: int, patch_size: float) -> str:
    return f"seed_{seed}.size_{patch_size:g}"


def make_streets(plan: StudyPlan) -> dict[str, SceneTask]:
    """Name the work that simulates each street."""
    surveys = {_street(seed): survey for seed, survey in plan.surveys().items()}
    return street_tasks(make_street, surveys, plan.ground)


def cut_streets(plan: StudyPlan, streets: SceneCollection) -> dict[str, SceneTask]:
    """Name the work that cuts each street into patches, in every size that it is used in."""
    runs = [*plan.tuning_runs(), *plan.all_runs(plan.parameters).values()]
    wanted = {_cut(seed, run.sizes.patch_size): (seed, run.sizes) for run in runs for seed in (*run.train, *run.test)}
    return {
        key: SceneTask(cut_patches, {"points": streets[_street(seed)]}, {"sizes": sizes, "scheme": plan.scheme})
        for key, (seed, sizes) in wanted.items()
    }


def _task(plan: StudyPlan, run: StudyRun, streets: SceneCollection, cut: SceneCollection) -> SceneTask:
    size = run.sizes.patch_size
    patches, labels = cut.part("patches"), cut.part("labels")

    def inputs(seeds: tuple[int, ...]) -> dict[str, Any]:
        return {
            _street(seed): {
                "points": streets[_street(seed)],
                "patches": patches[_cut(seed, size)],
                "labels": labels[_cut(seed, size)],
            }
            for seed in seeds
        }

    return SceneTask(
        train_and_score,
        {"train": inputs(run.train), "test": inputs(run.test)},
        {
            "method": run.method,
            "parameters": dict(run.parameters),
            "stages": plan.stages(run.sizes),
            "scheme": plan.scheme,
        },
    )


def try_settings(plan: StudyPlan, streets: SceneCollection, cut: SceneCollection) -> dict[str, SceneTask]:
    """Name the work that tries the settings of each method on training streets."""
    return {run.key: _task(plan, run, streets, cut) for run in plan.tuning_runs()}


def run_methods(
    plan: StudyPlan, streets: SceneCollection, cut: SceneCollection, tried: SceneCollection
) -> dict[str, SceneTask]:
    """Name the work that trains each method on each repetition, and the settings of the sensitivity figures."""
    parameters = plan.tuned(tried.load_all())
    return {key: _task(plan, run, streets, cut) for key, run in plan.all_runs(parameters).items()}


def tabulate_study(plan: StudyPlan, tried: SceneCollection, runs: SceneCollection) -> tuple[Any, ...]:
    """Make the tables of the study."""
    return study_tables(plan, tried.load_all(), runs.load_all()).as_tuple()
