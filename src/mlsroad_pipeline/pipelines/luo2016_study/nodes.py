"""Nodes of the study of Luo et al. 2016; the other stages are in `studies.luo2016.plan`."""

from __future__ import annotations

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.papers.luo2016.study.plan import StudyPlan
from mlsroad_pipeline.papers.luo2016.study.results import StudyTables, study_tables
from mlsroad_pipeline.papers.shared.studies.streets import make_street, street_tasks


def make_streets(plan: StudyPlan) -> dict[str, SceneTask]:
    """Create one task per street that simulates it."""
    columns = ("rgb", "label", "instance")
    return street_tasks(make_street, plan.surveys(), ground=plan.ground, columns=columns, with_station=True)


def tabulate_study(
    plan: StudyPlan, patches: SceneCollection, tried: SceneCollection, runs: SceneCollection
) -> StudyTables:
    """Make the tables."""
    counts = patches.part("counts")
    streets = {key: counts[key].load() for key in plan.counted_keys()}
    return study_tables(plan, streets, tried.load_all(), runs.load_all())
