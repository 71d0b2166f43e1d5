"""A survey looked at before anything is done with it."""

import logging

import pandas as pd

from mlsroad_pipeline.algorithms.quality_storage import quality_reports
from mlsroad_pipeline.datasets.scene_store import SceneCollection
from mlsroad_pipeline.datasets.survey_plan import SurveyPlan

logger = logging.getLogger(__name__)


def warn_of_quality(plan: SurveyPlan, pieces: SceneCollection) -> pd.DataFrame:
    """Log what is wrong with each file, and list it.

    Parameters
    ----------
    plan : SurveyPlan
        The files.
    pieces : SceneCollection
        Their ranges, inspected.

    Returns
    -------
    DataFrame
        Columns ``file`` and ``warning``.
    """
    reports = quality_reports({f.source.name: f.key for f in plan.files}, pieces.load_all("quality"))
    found = [(name, warning) for name, report in reports.items() for warning in report.warnings()]
    for name, warning in found:
        logger.warning("%s: %s", name, warning)
    return pd.DataFrame(found, columns=["file", "warning"])
