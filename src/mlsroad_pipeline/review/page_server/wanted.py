"""Values of requests of the page, checked."""

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError


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
