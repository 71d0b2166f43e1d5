"""What the workers of all studies share: making a street, and timing a step."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from mlsroad_pipeline.algorithms.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.scene_stages import GroundParameters, find_ground
from mlsroad_pipeline.algorithms.simulation.presets import SimulationParameters
from mlsroad_pipeline.algorithms.simulation.survey import simulate_survey
from mlsroad_pipeline.algorithms.trajectory import Trajectory

Value = TypeVar("Value")


def timed(function: Callable[..., Value], *given: Any, **options: Any) -> tuple[Value, float]:
    """Call a function and take its time.

    Parameters
    ----------
    function : callable
        What is called.
    *given, **options : any
        What it is given.

    Returns
    -------
    value : any
        What it gave.
    seconds : float
        Processor seconds of this process, all threads together.
    """
    start = time.process_time()
    found = function(*given, **options)
    return found, time.process_time() - start


def make_street(
    *, simulation: SimulationParameters, ground: GroundParameters, columns: Sequence[str] = ("rgb", "label")
) -> PointCloud:
    """Simulate a survey, find its ground and leave out what lies before its start and behind its end.

    Rays reach far beyond both ends, where no scene of the paper has points.

    Parameters
    ----------
    simulation : SimulationParameters
        The survey.
    ground : GroundParameters
        The ground filter.
    columns : sequence of str, default ("rgb", "label")
        What is kept of the survey.

    Returns
    -------
    PointCloud
        Points with these columns, `ground` and `height`.
    """
    survey = simulate_survey(simulation, n_threads=1)
    cloud = survey.cloud
    found = find_ground(cloud, ground)
    kept = {name: cloud[name] for name in columns}
    whole = PointCloud(cloud.xyz, {**kept, **found}, cloud.origin, cloud.crs, f"street of seed {simulation.seed}")
    path = Trajectory.from_positions(survey.trajectory[["x", "y", "z"]], survey.trajectory["gps_time"])
    station, _ = path.locate(cloud.xyz, origin=cloud.origin)
    return whole.select(np.flatnonzero((station >= 0) & (station <= path.length)))
