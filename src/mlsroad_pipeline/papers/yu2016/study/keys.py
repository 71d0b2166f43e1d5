"""Keys of streets, models and settings in the stores of the study of Yu et al. 2016."""

from __future__ import annotations

from collections.abc import Sequence


def street_key(survey: str, seed: int) -> str:
    """Return the key of a street."""
    return f"{survey}.seed_{seed}"


def run_key(survey: str, seed: int) -> str:
    """Return the key of a street in the result of a run."""
    return f"{survey}_{seed}"


def survey_of_run(key: str) -> str:
    """Return the survey of a key of `run_key`."""
    return key.rpartition("_")[0]


def model_key(detector: str, surveys: Sequence[str]) -> str:
    """Return the key of the model of a detector that is trained on some surveys."""
    return f"{detector}.{'_'.join(surveys)}"


def detector_of_model(key: str) -> str:
    """Return the detector of a key of `model_key`."""
    return key.partition(".")[0]


def setting_key(name: str) -> str:
    """Return the key of a setting in a store."""
    return name.replace("=", "-").replace(".", "_")
