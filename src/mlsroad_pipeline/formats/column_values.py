"""Conversion of colours and labels to the standard columns."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError


def join_colours(parts: Sequence[NDArray], shift: int, *, source: Path) -> NDArray[np.uint8]:
    """Join red, green and blue, integers, into uint8 of shape (n, 3); ``shift`` is 8 for colours of 16 bits, else 0."""
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
    """Turn one colour stored as floats into integers 0 to 255.

    ``greatest`` is the maximum colour of the whole file, which distinguishes ranges to 1, to 255 and to 65535.
    """
    wrong = values[~((values >= 0) & (values <= 65535))]
    if len(wrong):
        raise DataError(f"{source}: colour value {wrong[0]!r} is outside 0 to 65535")
    if greatest <= 1.0:
        return np.rint(values * 255.0).astype(np.int64)
    return np.rint(values).astype(np.int64) >> (0 if greatest <= 255.0 else 8)


def integer_labels(values: NDArray, name: str, *, source: Path) -> NDArray:
    """Return labels as integers (floats become int32); `DataError` if one is not a whole number."""
    if np.issubdtype(values.dtype, np.integer):
        return values
    with np.errstate(invalid="ignore"):  # values out of range differ after the cast and raise below
        whole = values.astype(np.int32)
    if not np.array_equal(whole, values):
        row = int(np.flatnonzero(whole != values)[0])
        raise DataError(f"{source}: column {name!r} holds {values[row]:g}, which is not a whole number")
    return whole
