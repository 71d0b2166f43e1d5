"""Nodes of the study of Tomic et al. 2019; the other stages are in `studies.tomic2019.plan`."""

from __future__ import annotations

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.papers.shared.studies.streets import street_tasks
from mlsroad_pipeline.papers.tomic2019.study import runs as tomic2019_runs
from mlsroad_pipeline.papers.tomic2019.study.plan import StudyPlan
from mlsroad_pipeline.papers.tomic2019.study.results import FusionRun, StudyTables, study_tables


def make_surveys(plan: StudyPlan) -> dict[str, SceneTask]:
    """Create one task per divided survey that simulates it."""
    return street_tasks(tomic2019_runs.make_survey, plan.surveys(), ground=plan.ground)


def make_photographs(plan: StudyPlan) -> dict[str, SceneTask]:
    """Create one task per street that simulates training images of the network."""
    return street_tasks(tomic2019_runs.make_photographs, plan.photographed())


def tabulate_study(
    plan: StudyPlan, features: SceneCollection, images: SceneCollection, runs: SceneCollection
) -> StudyTables:
    """Make the tables."""
    fused = {key: FusionRun.from_arrays(arrays) for key, arrays in runs.load_all("results").items()}
    matrices = {
        street: pixels["matrix"] for street, pixels in images.load_all("pixels").items() if street in plan.streets
    }
    return study_tables(plan, fused, matrices, features.load_all("facts"))
