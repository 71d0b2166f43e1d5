"""Nodes of the study of Luo et al. 2016; the other stages are in `studies.luo2016.plan`."""

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
from mlsroad_pipeline.studies.luo2016.plan import StudyPlan
from mlsroad_pipeline.studies.luo2016.results import StudyTables, study_tables
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
    methods = dict(zip(METHODS, (svm, forest, shapes, network, graph, refinement), strict=True))
    return luo2016_plan.plan_study(study, scheme=scheme, ground=ground, sizes=sizes, methods=methods)


def make_streets(plan: StudyPlan) -> dict[str, SceneTask]:
    """Create one task per street that simulates it."""
    return street_tasks(make_street, plan.surveys(), ground=plan.ground)


def tabulate_study(plan: StudyPlan, tried: SceneCollection, runs: SceneCollection) -> StudyTables:
    """Make the tables."""
    return study_tables(plan, tried.load_all(), runs.load_all())
