"""Conversion of colours and labels to the standard columns."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError


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
        raise DataError(f"{source}: column {name!r} holds {values[row]:g}, which is not a whole number")
    return whole
