"""Validation of the arguments of public functions."""

from collections.abc import Iterable, Mapping
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError


def check_xyz(xyz: ArrayLike, *, minimum: int = 0, name: str = "xyz") -> NDArray[np.floating]:
    """Validate coordinates and return them as a C-contiguous floating-point array.

    Parameters
    ----------
    xyz : array-like of shape (n, 3)
        Coordinates in metres; float32 and float64 are kept, anything else becomes float64.
    minimum : int, default 0
        Minimum number of points.
    name : str, default "xyz"
        Name of the array in error messages.

    Returns
    -------
    ndarray of shape (n, 3), float32 or float64
        The coordinates, copied only if the dtype or the memory layout requires it.

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
    if not np.isfinite(array).all():  # the row-wise test is several times slower: errors only
        finite = np.isfinite(array).all(axis=1)
        first = int(np.flatnonzero(~finite)[0])
        raise DataError(
            f"{name} has {int((~finite).sum())} points with NaN or infinite coordinates, "
            f"the first at row {first}: {array[first].tolist()}"
        )
    return np.ascontiguousarray(array)


def check_positive(value: float, name: str) -> float:
    """Check that a parameter is a positive, finite number and return it.

    Parameters
    ----------
    value : float
        The parameter.
    name : str
        Name in error messages.

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
    """Check that a parameter is not below its minimum.

    Parameters
    ----------
    value : float
        The parameter.
    least : float
        The minimum.
    name : str
        Name in error messages.

    Raises
    ------
    ParameterError
        If the value is below the minimum.
    """
    if value < least:
        raise ParameterError(f"{name} must be at least {least}, got {value!r}")


def check_column(values: ArrayLike, n_points: int, name: str, width: int | None = None) -> NDArray:
    """Check the shape of a per-point column and return it as an array.

    Parameters
    ----------
    values : array-like of shape (n_points,) or (n_points, width)
        The column.
    n_points : int
        Number of points.
    name : str
        Name in error messages.
    width : int, optional
        Number of values per point; None for a one-dimensional column.

    Returns
    -------
    ndarray
        The column as an array.

    Raises
    ------
    DataError
        If the shape differs.
    """
    array = np.asarray(values)
    expected = (n_points,) if width is None else (n_points, width)
    if array.shape != expected:
        raise DataError(f"{name} must have shape {expected}, got {array.shape}")
    return array


def check_arrays(arrays: Mapping[str, object], names: Iterable[str], owner: str) -> None:
    """Check that the arrays of a stored object are complete.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        The arrays.
    names : iterable of str
        Required names.
    owner : str
        The object, for the message, such as ``"a forest"``.

    Raises
    ------
    DataError
        If an array is missing.
    """
    missing = [name for name in names if name not in arrays]
    if missing:
        raise DataError(f"the arrays of {owner} lack {', '.join(missing)}")


def check_tested(columns: NDArray[np.integer], n_features: int, owner: str) -> None:
    """Check that trees test features that exist; kernels test no bounds.

    Parameters
    ----------
    columns : ndarray of int
        Feature that each node tests, negative in a leaf.
    n_features : int
        Number of features.
    owner : str
        The trees, for the message.

    Raises
    ------
    DataError
        If a node tests another feature.
    """
    if columns.max(initial=-1) >= n_features:
        raise DataError(f"{owner} tests feature {columns.max()} of {n_features}: the model is damaged")
