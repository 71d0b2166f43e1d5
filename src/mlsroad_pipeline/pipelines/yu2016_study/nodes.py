"""Nodes of the study of Yu et al. 2016; the other stages are in `studies.yu2016.plan`."""

from __future__ import annotations

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.papers.shared.studies.streets import street_tasks
from mlsroad_pipeline.papers.yu2016.study import results as yu2016_results
from mlsroad_pipeline.papers.yu2016.study.plan import StudyPlan
from mlsroad_pipeline.papers.yu2016.study.results import StudyTables, study_tables
from mlsroad_pipeline.papers.yu2016.study.streets import make_survey


def make_surveys(plan: StudyPlan) -> dict[str, SceneTask]:
    """Create one task per street that simulates it."""
    return street_tasks(make_survey, plan.surveys(), ground=plan.stages.ground)


def tabulate_study(plan: StudyPlan, *stores: SceneCollection) -> StudyTables:
    """Make the tables."""
    streets, segmented, described, runs, settings, compared = stores
    return study_tables(
        plan,
        streets.load_all("facts"),
        {**compared.load_all("scores"), **segmented.load_all("scores")},
        described.load_all("facts"),
        runs.load_all(),
        yu2016_results.runs_of_settings(plan, settings.load_all()),
    )
