"""Surveys without images of streets of any length, yielded in chunks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.simulation.furnishing.blocks import block_centre
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters
from mlsroad_pipeline.simulation.runtime.stream import SurveyStream
from mlsroad_pipeline.simulation.runtime.survey import as_float32
from mlsroad_pipeline.simulation.runtime.worker_pool import run_survey


def survey_chunks(parameters: SimulationParameters, *, n_points: int, n_threads: int = 1) -> Iterator[PointCloud]:
    """Yield a long survey without images in chunks.

    Parameters
    ----------
    parameters : SimulationParameters
        Survey parameters; the length follows from `n_points`.
    n_points : int
        Total number of points.
    n_threads : int, default 1
        Number of workers. The points do not depend on it.

    Yields
    ------
    PointCloud
        Some 100,000s of points each, in the order of gps_time, float32 relative to an origin of each chunk, so that
        streets of any length keep their precision. Only a few blocks of street are in memory at a time. Use
        `SurveyStream` for the trajectory.

    Raises
    ------
    ParameterError
        If `n_points` or `n_threads` is below 1.
    DataError
        If the street ends first, because hardly any pulse returned.
    """
    if n_points < 1:
        raise ParameterError(f"n_points must be >= 1, got {n_points!r}")
    yield from stream_points(long_survey(parameters, n_points=n_points, n_threads=n_threads), n_points=n_points)


def long_survey(parameters: SimulationParameters, *, n_points: int, n_threads: int = 1) -> SurveyStream:
    """Return a survey without images of a street long enough for a number of points; points are computed on demand.

    Parameters
    ----------
    parameters : SimulationParameters
        Survey parameters; their length and images are not used.
    n_points : int
        Number of points that the street must yield.
    n_threads : int, default 1
        Number of workers. The points do not depend on it.

    Returns
    -------
    SurveyStream
        The survey.

    Raises
    ------
    ParameterError
        If `n_threads` is below 1.
    """
    # About 60 % of the pulses return; a street longer than needed costs nothing.
    pulses = sum(device.pulse_rate for device in parameters.devices)
    length = 60.0 + n_points / (pulses * 0.3) * parameters.speed
    return SurveyStream(replace(parameters, with_images=False), length=length, n_threads=n_threads)


def stream_points(stream: SurveyStream, *, n_points: int) -> Iterator[PointCloud]:
    """Yield the first points of a survey in chunks; see `survey_chunks`.

    Parameters
    ----------
    stream : SurveyStream
        The survey.
    n_points : int
        Total number of points, at least 1.

    Yields
    ------
    PointCloud
        Points in the order of gps_time, float32 relative to an origin of each chunk.

    Raises
    ------
    DataError
        If the street ends first.
    """
    left = n_points
    for chunk in run_survey(stream):
        if chunk.cloud is None:
            continue
        centre, _ = block_centre(stream.street, chunk.number)
        shifted = chunk.cloud.moved_to(chunk.cloud.origin + centre)
        part = as_float32(shifted if len(shifted) <= left else shifted.select(np.arange(left)))
        left -= len(part)
        yield part
        if left == 0:
            return
    raise DataError(f"the street ended {left} points short of {n_points}")
