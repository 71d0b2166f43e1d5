"""Values of requests of the page, checked."""

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.plain_text import shortened

LARGEST = 2048
"""Longer side of a picture of the background, pixels."""


def places_of(value: object) -> np.ndarray:
    """Return places x, y, z."""
    try:
        places = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DataError("places must be numbers x, y, z") from error
    if places.ndim != 2 or places.shape[1] != 3 or not 1 <= len(places) <= 200 or not np.isfinite(places).all():
        raise DataError("places must be 1 to 200 finite x, y, z")
    return places


def radius_of(value: object) -> float:
    """Return the radius of a brush, metres."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not 0.01 <= value <= 5.0:
        raise ParameterError(f"the radius of the brush must be 0.01 m to 5 m, got {value!r}")
    return float(value)


def only_of(value: object) -> int | None:
    """Return the code of the only class that is selected, None for all."""
    if value is not None and (not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= 255):
        raise ParameterError(f"only must be a class code from 0 to 255, got {value!r}")
    return value


def area_of(text: str) -> tuple[float, float, float, float]:
    """Return an area of a request; ParameterError for what is none."""
    values = _numbers(text, 4)
    if values[0] >= values[2] or values[1] >= values[3] or max(map(abs, values)) > 1e9:
        raise ParameterError(f"area must be west, south, east, north, got {text!r}")
    return values[0], values[1], values[2], values[3]


def size_of(text: str) -> tuple[int, int]:
    """Return the size of a picture of a request; ParameterError for what is none."""
    width, height = (int(value) for value in _numbers(text, 2))
    if not (1 <= width <= LARGEST and 1 <= height <= LARGEST):
        raise ParameterError(f"size must be two numbers from 1 to {LARGEST}, got {text!r}")
    return width, height


def _numbers(text: str, n: int) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != n or not np.isfinite(values).all():
        raise ParameterError(f"{n} numbers are needed, got {shortened(text)!r}")
    return values
