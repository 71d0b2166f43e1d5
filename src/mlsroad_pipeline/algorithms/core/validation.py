"""Validation of the arguments of public functions, and groups of parameters that are given as mappings."""

from collections.abc import Callable, Iterable, Mapping
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError


def check_xyz(xyz: ArrayLike, *, minimum: int = 0, name: str = "xyz") -> NDArray[np.floating]:
    """Validate coordinates and return them as a C-contiguous floating-point array."""
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
    """Check that a parameter is a positive, finite number and return it."""
    if not isinstance(value, Real) or not np.isfinite(value) or value <= 0:
        raise ParameterError(f"{name} must be a finite number > 0, got {value!r}")
    return float(value)


def check_at_least(value: float, least: float, name: str) -> None:
    """Check that a parameter is not below its minimum."""
    if value < least:
        raise ParameterError(f"{name} must be at least {least}, got {value!r}")


def check_column(values: ArrayLike, n_points: int, name: str, width: int | None = None) -> NDArray:
    """Check the shape of a per-point column and return it as an array."""
    array = np.asarray(values)
    expected = (n_points,) if width is None else (n_points, width)
    if array.shape != expected:
        raise DataError(f"{name} must have shape {expected}, got {array.shape}")
    return array


def check_arrays(arrays: Mapping[str, object], names: Iterable[str], owner: str) -> None:
    """Check that the arrays of a stored object are complete."""
    missing = [name for name in names if name not in arrays]
    if missing:
        raise DataError(f"the arrays of {owner} lack {', '.join(missing)}")


def check_tested(columns: NDArray[np.integer], n_features: int, owner: str) -> None:
    """Check that trees test features that exist; kernels test no bounds."""
    if columns.max(initial=-1) >= n_features:
        raise DataError(f"{owner} tests feature {columns.max()} of {n_features}: the model is damaged")


def parse_groups(parameters: object, **kinds: Callable[..., object]) -> None:
    """Replace mappings among the fields of frozen parameters by instances of their classes."""
    for name, kind in kinds.items():
        given = getattr(parameters, name)
        if isinstance(given, Mapping):
            object.__setattr__(parameters, name, kind(**given))
