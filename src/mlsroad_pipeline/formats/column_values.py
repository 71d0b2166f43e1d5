"""Conversion of intensities, colours and labels to the standard columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError


def intensity_divisor(dtype: np.dtype, rule: str | float, maximum: Callable[[], float]) -> float:
    """Return the divisor of a file's intensities.

    Parameters
    ----------
    dtype : dtype
        The column's type in the file.
    rule : "dtype" or "max" or float
        See `ReadOptions.intensity_scale`.
    maximum : callable
        Returns the maximum intensity of the whole file; called only for the rule "max".

    Returns
    -------
    float
        The divisor, above zero.
    """
    if not isinstance(rule, str):
        return float(rule)
    if rule == "dtype" and np.issubdtype(dtype, np.integer):
        return float(np.iinfo(dtype).max)
    greatest = maximum()
    if rule == "dtype":
        greatest = next((full for full in (1.0, 255.0, 65535.0) if greatest <= full), greatest)
    return greatest if 0 < greatest < np.inf else 1.0


def scale_intensity(values: NDArray, divisor: float, *, source: Path) -> NDArray[np.float32]:
    """Scale intensities to [0, 1].

    Parameters
    ----------
    values : ndarray of shape (n,)
        Intensities of the file.
    divisor : float
        See `intensity_divisor`.
    source : Path
        File name in messages.

    Returns
    -------
    ndarray of shape (n,), float32
        Intensities; NaN where the file has NaN.

    Raises
    ------
    DataError
        If one falls outside [0, 1].
    """
    with np.errstate(over="ignore", invalid="ignore"):  # overflows raise below
        scaled = (values / divisor).astype(np.float32)
    low, high = np.fmin.reduce(scaled, initial=np.nan), np.fmax.reduce(scaled, initial=np.nan)  # NaN where all are
    if low < 0 or high > 1:
        raise DataError(
            f"{source}: intensities {low * divisor:g} to {high * divisor:g} divided by {divisor:g} leave [0, 1]; "
            "set intensity_scale"
        )
    return scaled


def join_colours(parts: Sequence[NDArray], shift: int, *, source: Path) -> NDArray[np.uint8]:
    """Join three colour columns into one of eight bits.

    Parameters
    ----------
    parts : sequence of three ndarrays of shape (n,)
        Red, green and blue as integers.
    shift : int
        Bits to drop: 8 for colours of 16 bits, else 0.
    source : Path
        File name in messages.

    Returns
    -------
    ndarray of shape (n, 3), uint8
        The colours.

    Raises
    ------
    DataError
        If a value does not fit into eight bits after the shift.
    """
    rgb = np.empty((len(parts[0]), 3), dtype=np.uint8)
    for axis, part in enumerate(parts):
        values = part >> shift if shift else part
        if values.dtype != np.uint8 and len(values) and not 0 <= values.min() <= values.max() <= 255:
            raise DataError(
                f"{source}: colour value {values.max()} in a file with assumed 8-bit colours; set rgb_bits: 16"
            )
        rgb[:, axis] = values
    return rgb


def float_colours(values: NDArray, greatest: float, *, source: Path) -> NDArray[np.int64]:
    """Turn colours stored as floats into integers of 8 or 16 bits.

    Parameters
    ----------
    values : ndarray of shape (n,), floating
        One colour, in [0, 1], [0, 255] or [0, 65535].
    greatest : float
        Maximum colour value of the whole file, which distinguishes the three ranges.
    source : Path
        File name in messages.

    Returns
    -------
    ndarray of shape (n,), int64
        The colour in 0 to 255.

    Raises
    ------
    DataError
        If a colour is not a number or outside 0 to 65535.
    """
    wrong = values[~((values >= 0) & (values <= 65535))]
    if len(wrong):
        raise DataError(f"{source}: colour value {wrong[0]!r} is outside 0 to 65535")
    if greatest <= 1.0:
        return np.rint(values * 255.0).astype(np.int64)
    return np.rint(values).astype(np.int64) >> (0 if greatest <= 255.0 else 8)


def integer_labels(values: NDArray, name: str, *, source: Path) -> NDArray:
    """Return labels as integers.

    Parameters
    ----------
    values : ndarray of shape (n,)
        Labels of the file, integers or floats.
    name : str
        The column's name.
    source : Path
        File name in messages.

    Returns
    -------
    ndarray of shape (n,), integer
        The labels; those stored as floats become int32.

    Raises
    ------
    DataError
        If a label is not a whole number.
    """
    if np.issubdtype(values.dtype, np.integer):
        return values
    with np.errstate(invalid="ignore"):  # values out of range differ after the cast and raise below
        whole = values.astype(np.int32)
    if not np.array_equal(whole, values):
        row = int(np.flatnonzero(whole != values)[0])
        raise DataError(f"{source}: column {name!r} holds {values[row]!r}, which is not a whole number")
    return whole
