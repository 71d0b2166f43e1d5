"""The survey simulator: a street that a mobile mapping van really scans."""

from mlsroad_pipeline.algorithms.simulation.cameras import Image
from mlsroad_pipeline.algorithms.simulation.devices import Device, ScannerSystem
from mlsroad_pipeline.algorithms.simulation.known_scanners import SCANNERS
from mlsroad_pipeline.algorithms.simulation.long_surveys import long_survey, stream_points, survey_chunks
from mlsroad_pipeline.algorithms.simulation.presets import PRESETS, SimulationParameters
from mlsroad_pipeline.algorithms.simulation.stream import SurveyStream
from mlsroad_pipeline.algorithms.simulation.survey import Survey, SurveyPieces, simulate_survey

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
    "long_survey",
    "simulate_survey",
    "stream_points",
    "survey_chunks",
]
