"""A simulated survey written as a real one is delivered: LAZ, trajectory, images with calibration, and the truth."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Picture

from mlsroad_pipeline.algorithms.exceptions import ParameterError
from mlsroad_pipeline.algorithms.simulation.cameras import Image
from mlsroad_pipeline.algorithms.simulation.presets import PRESETS, SimulationParameters
from mlsroad_pipeline.algorithms.simulation.street_parameters import street_parameters
from mlsroad_pipeline.algorithms.simulation.survey import Survey, simulate_survey
from mlsroad_pipeline.datasets.formats.las import LasFormat
from mlsroad_pipeline.datasets.formats.options import WriteOptions

POINTS, TRAJECTORY = "survey.laz", "trajectory.csv"

SCAN_ANGLE_STEP = 0.006
"""Degrees per unit of the scan angle in LAS 1.4."""


def simulation_parameters(config: Mapping[str, Any]) -> SimulationParameters:
    """Read simulation parameters from configuration.

    Parameters
    ----------
    config : mapping
        ``preset``, and fields of `SimulationParameters` that differ from it; ``street`` is the name of a kind of
        street, or a mapping of ``kind`` and fields of `StreetParameters`.

    Returns
    -------
    SimulationParameters
        The parameters.

    Raises
    ------
    ParameterError
        If the preset or a field is unknown, or a value is outside its domain.
    """
    changes = dict(config)
    preset = changes.pop("preset", "demo")
    if preset not in PRESETS:
        raise ParameterError(f"simulation preset {preset!r} is unknown (presets: {', '.join(PRESETS)})")
    known = {field.name for field in fields(SimulationParameters)}
    unknown = sorted(set(changes) - known)
    if unknown:
        raise ParameterError(f"unknown simulation parameters: {', '.join(unknown)} (known: {', '.join(sorted(known))})")
    if "street" in changes:
        changes["street"] = street_parameters(changes["street"])
    return replace(PRESETS[preset], **changes)


def write_simulated_survey(*, parameters: SimulationParameters, folder: str, n_threads: int) -> dict[str, NDArray]:
    """Simulate a survey and write it into a folder, which appears whole or not at all.

    Parameters
    ----------
    parameters : SimulationParameters
        What is surveyed, and how.
    folder : str
        The folder; an old one is replaced.
    n_threads : int
        Threads to use; the survey does not depend on it.

    Returns
    -------
    dict of str to ndarray
        ``n_points`` and ``n_images``.

    Raises
    ------
    ParameterError
        If a parameter is wrong.
    """
    survey = simulate_survey(parameters, n_threads=n_threads)
    target = Path(folder)
    fresh = target.with_name(f".{target.name}.new")
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    _write_points(survey, fresh / POINTS)
    survey.trajectory.to_csv(fresh / TRAJECTORY, index=False, float_format="%.6f")
    survey.objects.to_csv(fresh / "objects.csv", index=False, float_format="%.3f")
    _write_images(survey.images, fresh, survey.origin)
    if target.exists():
        shutil.rmtree(target)
    fresh.rename(target)
    return {"n_points": np.array(len(survey.cloud)), "n_images": np.array(len(survey.images))}


def _write_points(survey: Survey, path: Path) -> None:
    steps = np.round(survey.cloud["scan_angle"] / SCAN_ANGLE_STEP).astype(np.int16)
    LasFormat().write(path, survey.cloud.with_columns(scan_angle=steps), WriteOptions(like="none"))


def _write_images(images: Sequence[Image], folder: Path, origin: NDArray[np.float64]) -> None:
    """Write pictures, their truth and one calibration file; poses are in world coordinates minus the origin."""
    if not images:
        return
    for kind in ("images", "labels"):
        (folder / kind).mkdir()
    views = []
    for image in images:
        Picture.fromarray(image.rgb).save(folder / "images" / f"{image.name}.png")
        Picture.fromarray(image.label).save(folder / "labels" / f"{image.name}.png")
        views.append(
            {
                "name": image.name,
                "camera": str(image.camera),
                "gps_time": float(image.time),
                "K": np.asarray(image.K).tolist(),
                "R": np.asarray(image.R).tolist(),
                "t": np.asarray(image.t).tolist(),
                "width": int(image.width),
                "height": int(image.height),
            }
        )
    calibration = {"origin": origin.tolist(), "convention": "p_cam = R (p_world - origin) + t", "images": views}
    (folder / "calibration.json").write_text(json.dumps(calibration, indent=1) + "\n", encoding="utf-8")
