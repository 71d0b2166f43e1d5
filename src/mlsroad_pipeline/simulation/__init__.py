"""Survey simulator: procedural streets, scanned and photographed by ray casting from a mobile mapping van."""

from mlsroad_pipeline.simulation.cameras.cameras import Image
from mlsroad_pipeline.simulation.parameters.devices import Device, ScannerSystem
from mlsroad_pipeline.simulation.parameters.known_scanners import SCANNERS
from mlsroad_pipeline.simulation.parameters.presets import PRESETS, SimulationParameters, another_year
from mlsroad_pipeline.simulation.runtime.stream import SurveyStream
from mlsroad_pipeline.simulation.runtime.survey import (
    Survey,
    SurveyPieces,
    long_survey,
    simulate_survey,
    stream_points,
)

__all__ = [
    "PRESETS",
    "SCANNERS",
    "Device",
    "Image",
    "ScannerSystem",
    "SimulationParameters",
    "Survey",
    "SurveyPieces",
    "SurveyStream",
    "another_year",
    "long_survey",
    "simulate_survey",
    "stream_points",
]
