"""Checks at the border of every public function: one clear message instead of a wrong answer later."""

from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError


def check_xyz(xyz: ArrayLike, *, minimum: int = 0, name: str = "xyz") -> NDArray[np.floating]:
    """Return coordinates as a C-contiguous floating array, or say what is wrong with them.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates in metres; float32 and float64 are kept, anything else becomes float64.
    minimum : int, default 0
        The fewest points that the caller can work with.
    name : str, default "xyz"
        What the message calls the array.

    Returns
    -------
    ndarray of shape (n, 3), float32 or float64
        The coordinates, copied only where the dtype or the layout requires it.

    Raises
    ------
    DataError
        If the shape is not (n, 3), if there are fewer than `minimum` points, or if a coordinate is NaN or infinite.
    """
    array = np.asarray(xyz)
    if array.dtype not in (np.float32, np.float64):
        array = array.astype(np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise DataError(f"{name} must have shape (n, 3), got {array.shape}")
    if len(array) < minimum:
        raise DataError(f"{name} needs at least {minimum} points, got {len(array)}")
    if not np.isfinite(array).all():  # row by row only where something is wrong: it is several times slower
        finite = np.isfinite(array).all(axis=1)
        first = int(np.flatnonzero(~finite)[0])
        raise DataError(
            f"{name} has {int((~finite).sum())} points with NaN or infinite coordinates, "
            f"the first at row {first}: {array[first].tolist()}"
        )
    return np.ascontiguousarray(array)


def check_positive(value: float, name: str) -> float:
    """Return a parameter that must be a positive, finite number.

    Parameters
    ----------
    value : float
        The parameter.
    name : str
        Its name, for the message.

    Returns
    -------
    float
        The value.

    Raises
    ------
    ParameterError
        If the value is not a finite number above zero.
    """
    if not isinstance(value, Real) or not np.isfinite(value) or value <= 0:
        raise ParameterError(f"{name} must be a finite number > 0, got {value!r}")
    return float(value)


def check_at_least(value: float, least: float, name: str) -> None:
    """Make sure that a parameter is not below the least that makes sense.

    Parameters
    ----------
    value : float
        The parameter.
    least : float
        The least.
    name : str
        Its name, for the message.

    Raises
    ------
    ParameterError
        If it is below.
    """
    if value < least:
        raise ParameterError(f"{name} must be at least {least}, got {value!r}")


def check_column(values: ArrayLike, n_points: int, name: str, width: int | None = None) -> NDArray:
    """Return a per-point column whose length fits the points.

    Parameters
    ----------
    values : array-like of shape (n_points,) or (n_points, width)
        The column.
    n_points : int
        How many points it must describe.
    name : str
        Its name, for the message.
    width : int, optional
        The number of values per point; None asks for a one-dimensional column.

    Returns
    -------
    ndarray
        The column as an array.

    Raises
    ------
    DataError
        If the shape differs from what is asked for.
    """
    array = np.asarray(values)
    expected = (n_points,) if width is None else (n_points, width)
    if array.shape != expected:
        raise DataError(f"{name} must have shape {expected}, got {array.shape}")
    return array
