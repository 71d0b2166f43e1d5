"""Class schemes by the names in the parameters."""

from collections.abc import Mapping
from typing import Any

from mlsroad_pipeline.algorithms.core.classes import ClassScheme, find_scheme
from mlsroad_pipeline.papers.shared.detection.scoring import DetectionParameters
from mlsroad_pipeline.papers.shared.recognition.cutting import RecognitionParameters
from mlsroad_pipeline.surveys.parameters import SurveyParameters


def training_scheme(survey: SurveyParameters, classes: Mapping[str, Any]) -> ClassScheme:
    """Return the scheme that labellers are trained on."""
    return find_scheme(classes["schemes"], survey.scheme)


def evaluation_scheme(survey: SurveyParameters, classes: Mapping[str, Any]) -> ClassScheme:
    """Return the scheme that labellers are scored on."""
    return find_scheme(classes["schemes"], survey.evaluation_scheme or survey.scheme)


def detection_scheme(parameters: DetectionParameters, classes: Mapping[str, Any]) -> ClassScheme:
    """Return the scheme of the detectors."""
    return find_scheme(classes["schemes"], parameters.scheme)


def recognition_scheme(parameters: RecognitionParameters, classes: Mapping[str, Any]) -> ClassScheme:
    """Return the scheme of the recognisers."""
    return find_scheme(classes["schemes"], parameters.scheme)
