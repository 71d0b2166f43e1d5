"""Simulated streets of all studies, and timing of functions."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters, simulation_parameters
from mlsroad_pipeline.simulation.runtime.survey import Survey, simulate_survey
from mlsroad_pipeline.simulation.street.drive import PAUSE

Value = TypeVar("Value")


def street_key(seed: int) -> str:
    """Return the key of a street in the stores of a study."""
    return f"seed_{seed}"


def timed(function: Callable[..., Value], *arguments: Any, **options: Any) -> tuple[Value, float]:
    """Call a function, and return its value and its CPU time in seconds."""
    start = time.process_time()
    value = function(*arguments, **options)
    return value, time.process_time() - start


def street_tasks(
    make: Callable[..., Any], surveys: Mapping[str, Mapping[str, Any]], **parameters: Any
) -> dict[str, SceneTask]:
    """Create one task per street that simulates it; `parameters` are further arguments of `make`."""
    return {
        key: SceneTask(make, parameters={"simulation": simulation_parameters(survey), **parameters})
        for key, survey in surveys.items()
    }


def make_street(
    *,
    simulation: SimulationParameters,
    ground: GroundParameters,
    columns: Sequence[str] = ("rgb", "label"),
    reach: float = np.inf,
    with_station: bool = False,
) -> PointCloud:
    """Simulate a survey, classify its ground and cut it at both ends of the street.

    Rays reach far beyond both ends, where the scenes of the papers have no points. `with_station` adds the column
    `station`: the way along the trajectory in metres, float32.
    """
    source = f"street of seed {simulation.seed}"
    survey = simulate_survey(simulation, n_threads=1)
    cloud, station = cut_street(survey, ground=ground, columns=columns, source=source, reach=reach)
    return cloud.with_columns(station=station.astype(np.float32)) if with_station else cloud


def cut_street(
    survey: Survey, *, ground: GroundParameters, columns: Sequence[str], source: str, reach: float = np.inf
) -> tuple[PointCloud, NDArray[np.float64]]:
    """Classify the ground of a survey and cut it at both ends of the street; also return the station of each point."""
    cloud = survey.cloud
    kept = PointCloud(cloud.xyz, {name: cloud[name] for name in columns}, cloud.origin, cloud.crs, source)
    whole = kept.with_columns(**find_ground(cloud, ground))
    path = survey_path(survey)
    station, offset = path.locate(cloud.xyz, origin=cloud.origin)
    rows = np.flatnonzero((station >= 0) & (station <= path.length) & (np.abs(offset) <= reach))
    return whole.select(rows), station[rows]


def survey_path(survey: Survey) -> Trajectory:
    """Return the track of the first pass of a simulated survey; all passes have the same route and direction."""
    time = survey.trajectory["gps_time"].to_numpy()
    # Stations along several passes would not be positions along the street.
    first = survey.trajectory[np.cumsum(np.diff(time, prepend=time[0]) > 0.5 * PAUSE) == 0]
    return Trajectory.from_positions(first[["x", "y", "z"]], first["gps_time"])
