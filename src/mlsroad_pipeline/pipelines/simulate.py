"""Simulated surveys by ray casting, in the files of a recording."""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kedro.pipeline import Pipeline

from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.pipelines.per_scene import named_node
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.simulated import TRAJECTORY, configured_survey, selected_surveys, write_simulated_survey

log = logging.getLogger(__name__)

THREADS = 2
"""Workers of a survey that is simulated alone; several run in parallel with one worker each."""


def simulate_surveys(simulation: Mapping[str, Any], survey: SurveyParameters) -> dict[str, SceneTask]:
    """Create one task per selected survey."""
    selected = selected_surveys(simulation)
    n_threads = THREADS if len(selected) == 1 else 1
    tasks = {}
    for name, config in selected.items():
        parameters, files = configured_survey(config)
        if "varied" in config:
            log.info("%s: %s", name, dict(config))
        folder = Path(str(survey.root)) / name
        tasks[name] = SceneTask(
            write_simulated_survey,
            parameters={"parameters": parameters, "folder": str(folder), "n_threads": n_threads, "files": files},
            outputs=tuple(str(folder / file) for file in (*files.names(parameters), TRAJECTORY)),
        )
    return tasks


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: parameters to surveys below the survey root."""
    return Pipeline([named_node(simulate_surveys, "simulated_surveys")])
