"""Simulated surveys, where the environment enables them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.surveys.parameters import SurveyParameters
from mlsroad_pipeline.surveys.simulated import (
    TRAJECTORY,
    simulation_parameters,
    survey_files,
    write_simulated_survey,
)

THREADS = 2
"""Workers of a survey that is simulated alone; several run in parallel with one worker each."""


def simulate_surveys(simulation: Mapping[str, Any], survey: SurveyParameters) -> dict[str, SceneTask]:
    """Create one task per survey."""
    if not simulation["enabled"]:
        return {}
    if simulation["only"] not in (None, *simulation["surveys"]):
        raise ParameterError(f"simulation.only {simulation['only']!r} is none of {', '.join(simulation['surveys'])}")
    selected = [n for n, c in simulation["surveys"].items() if c is not None and simulation["only"] in (None, n)]
    n_threads = THREADS if len(selected) == 1 else 1
    tasks = {}
    for name, config in simulation["surveys"].items():
        if name not in selected:
            continue
        parameters, files = simulation_parameters(config), survey_files(config)
        folder = Path(str(survey.root)) / name
        tasks[name] = SceneTask(
            write_simulated_survey,
            parameters={"parameters": parameters, "folder": str(folder), "n_threads": n_threads, "files": files},
            outputs=(*(str(folder / file) for file in files.names(parameters)), str(folder / TRAJECTORY)),
        )
    return tasks
