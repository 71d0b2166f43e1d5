"""Surveys simulated where the environment asks for them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mlsroad_pipeline.datasets.scene_task import SceneTask
from mlsroad_pipeline.datasets.simulated_survey import (
    POINTS,
    TRAJECTORY,
    simulation_parameters,
    write_simulated_survey,
)
from mlsroad_pipeline.datasets.survey_plan import SurveyParameters

THREADS = 2


def simulate_surveys(simulation: Mapping[str, Any], survey: SurveyParameters) -> dict[str, SceneTask]:
    """Name the work that simulates each survey.

    Parameters
    ----------
    simulation : mapping
        ``enabled``, and ``surveys``: folder below the root to preset and differences from it, or to None for no such
        survey.
    survey : SurveyParameters
        The root.

    Returns
    -------
    dict of str to SceneTask
        One task per survey; none where the environment brings its own.
    """
    if not simulation["enabled"]:
        return {}
    tasks = {}
    for name, config in simulation["surveys"].items():
        if config is None:
            continue
        folder = Path(str(survey.root)) / name
        tasks[name] = SceneTask(
            write_simulated_survey,
            parameters={"parameters": simulation_parameters(config), "folder": str(folder), "n_threads": THREADS},
            outputs=(str(folder / POINTS), str(folder / TRAJECTORY)),
        )
    return tasks
