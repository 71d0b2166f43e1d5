"""Scenes of simulated streets, and labels that are ignored in training."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud, concatenate
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters
from mlsroad_pipeline.simulation.runtime.survey import SurveyPieces


def make_scenes(*, simulation: SimulationParameters, scan_spacing: float | None) -> dict[str, PointCloud]:
    """Simulate a street: one scene of all points, or one per revolution of the first scanner at a spacing."""
    pieces = SurveyPieces(simulation, n_threads=1)
    clouds: dict[int, list[PointCloud]] = {}
    for cloud, _ in pieces:
        kept = PointCloud(cloud.xyz, {"intensity": cloud["intensity"], "label": cloud["label"]}, cloud.origin)
        if scan_spacing is None:
            clouds.setdefault(0, []).append(kept)
            continue
        owner = pieces.piece_of(cloud["gps_time"], scan_spacing)
        for number in np.unique(owner):
            rows = owner == number
            clouds.setdefault(int(number), []).append(kept.select(rows).with_columns(gps_time=cloud["gps_time"][rows]))
    joined = {number: concatenate(parts) for number, parts in clouds.items()}
    if scan_spacing is not None:
        period = 1.0 / simulation.devices[0].profile_rate
        joined = {number: _first_revolution(cloud, period) for number, cloud in joined.items()}
    return {f"scene_{number:03d}": cloud for number, cloud in joined.items() if len(cloud)}


def _first_revolution(cloud: PointCloud, period: float) -> PointCloud:
    seconds = cloud["gps_time"] - cloud["gps_time"].min()
    return cloud.select(seconds < period).without_columns(["gps_time"])


def ignoring(cloud: PointCloud, rows: NDArray[np.bool_]) -> PointCloud:
    """Return a cloud whose labels in some rows are ignored."""
    label = cloud["label"].copy()
    label[rows] = TAXONOMY["unlabelled"]
    return cloud.with_columns(label=label)


def scenes_in(loaded: PointCloud | Mapping[str, PointCloud]) -> dict[str, PointCloud]:
    """Return the scenes of a stored result: one of a recording, several of a street."""
    return {"scene_000": loaded} if isinstance(loaded, PointCloud) else dict(loaded)
