"""Nodes of the study of Luo et al. 2016; the other stages are in `studies.luo2016.plan`."""

from __future__ import annotations

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.studies.luo2016.plan import StudyPlan
from mlsroad_pipeline.studies.luo2016.results import StudyTables, study_tables
from mlsroad_pipeline.studies.streets import make_street, street_tasks


def make_streets(plan: StudyPlan) -> dict[str, SceneTask]:
    """Create one task per street that simulates it."""
    return street_tasks(make_street, plan.surveys(), ground=plan.ground)


def tabulate_study(plan: StudyPlan, tried: SceneCollection, runs: SceneCollection) -> StudyTables:
    """Make the tables."""
    return study_tables(plan, tried.load_all(), runs.load_all())
