"""Pipeline that reports the quality of a survey."""

import logging
from typing import Any

import pandas as pd
from kedro.pipeline import Pipeline

from mlsroad_pipeline.label.checks import output_problems
from mlsroad_pipeline.pipelines.per_scene import named_node
from mlsroad_pipeline.reporting.inspection_page import survey_page
from mlsroad_pipeline.surveys.files import Survey
from mlsroad_pipeline.surveys.inspection import (
    InspectParameters,
    inspect_survey,
    inspection_warnings,
    offsets_of_files,
    survey_facts,
)
from mlsroad_pipeline.surveys.parameters import SurveyParameters

logger = logging.getLogger(__name__)


def inspect_files(parameters: InspectParameters, survey: SurveyParameters) -> tuple[dict[str, Any], str, pd.DataFrame]:
    """Inspect the files of a survey, log the warnings, and return facts, report page and warnings."""
    places, read = (parameters.survey, parameters.read) if parameters.survey else (str(survey.root), survey.read)
    files, unread = inspect_survey(parameters, root=places, read=read, problems_of=output_problems)
    root = Survey.at(places).root
    offsets = offsets_of_files(parameters, files, read=read)
    warnings = inspection_warnings(files, unread, offsets)
    for row in warnings.itertuples():
        logger.warning("%s: %s", row.file, row.warning)
    page = survey_page(root, [file.facts for file in files], {file.name: file.picture for file in files}, warnings)
    return survey_facts(root, files, warnings, offsets), page, warnings


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline from the files of a survey to a quality report and warnings."""
    return Pipeline([named_node(inspect_files, ["inspection", "inspection_report", "survey_warnings"], slug="inspect")])
