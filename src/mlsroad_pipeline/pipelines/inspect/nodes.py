"""A survey looked at before anything is done with it."""

import logging
from typing import Any

import pandas as pd

from mlsroad_pipeline.datasets.inspect_report import survey_facts, survey_page, survey_warnings
from mlsroad_pipeline.datasets.inspect_work import FileInspection, InspectParameters, inspect_survey
from mlsroad_pipeline.datasets.survey_plan import SurveyParameters

logger = logging.getLogger(__name__)


def look_through(
    parameters: InspectParameters, survey: SurveyParameters
) -> tuple[list[FileInspection], pd.DataFrame, str]:
    """Look through the files of a survey, and log what is wrong with each.

    Parameters
    ----------
    parameters : InspectParameters
        The survey to inspect.
    survey : SurveyParameters
        The survey of the comparison, inspected where no other is named.

    Returns
    -------
    tuple of list of FileInspection, DataFrame and str
        What was found, the warnings (columns ``file`` and ``warning``), and the survey's root.
    """
    root = parameters.survey or str(survey.root)
    files, unread = inspect_survey(parameters, root=root, read=parameters.read if parameters.survey else survey.read)
    warnings = survey_warnings(files, unread)
    for row in warnings.itertuples():
        logger.warning("%s: %s", row.file, row.warning)
    return files, warnings, root


def report_survey(files: list[FileInspection], warnings: pd.DataFrame, root: str) -> tuple[dict[str, Any], str]:
    """Write the report.

    Parameters
    ----------
    files : list of FileInspection
        What was found in each file.
    warnings : DataFrame
        The warnings.
    root : str
        The survey's root.

    Returns
    -------
    tuple of dict and str
        The figures as plain data, and the page.
    """
    return survey_facts(root, files, warnings), survey_page(root, files, warnings)
