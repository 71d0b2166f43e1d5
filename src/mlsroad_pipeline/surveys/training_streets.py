"""Simulated streets that models of the package are trained on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters, expanded_surveys, simulation_parameters
from mlsroad_pipeline.simulation.runtime.survey import simulate_survey

StreetParameters = SimulationParameters
"""Parameters of a simulated street."""

MOST_POINTS = 2_500_000
"""Points of a street from which on it is left out."""


def street_parameters(config: Mapping[str, Any]) -> StreetParameters:
    """Return the parameters of a street from its configuration."""
    return simulation_parameters(config)


def street_surveys(surveys: Mapping[str, Any]) -> dict[str, Any]:
    """Return the configurations of streets by name, those with varied objects expanded."""
    return dict(expanded_surveys(surveys))


def simulated_cloud(simulation: StreetParameters) -> PointCloud:
    """Return the points of a simulated street."""
    return simulate_survey(simulation).cloud


def simulate_street(*, simulation: StreetParameters) -> dict[str, Any]:
    """Simulate a street; one of too many points is returned without points."""
    survey = simulate_survey(simulation, n_threads=1)
    cloud = survey.cloud.select(np.arange(len(survey.cloud) if len(survey.cloud) <= MOST_POINTS else 0))
    points = {
        "xyz": cloud.xyz.astype(np.float32), "origin": np.asarray(survey.origin), "intensity": cloud["intensity"],
        "truth": cloud["label"].astype(np.uint8), "instance": cloud["instance"].astype(np.int32),
    }  # fmt: skip
    return {"points": points, "objects": survey.objects}
