"""Coordinates in floats of less than 64 bits, whose steps are too coarse far from zero."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

StoredCoordinates = Callable[[int, int], Sequence[NDArray]]
"""Function of a range of rows that returns their coordinates as stored."""

LARGEST_STEP = 0.01
"""Largest distance of neighbouring numbers, in metres, that causes no warning."""

SAMPLES, SAMPLE = 5, 200
"""Number and length of the runs of points whose coordinates are compared with their type."""


def step_note(rows: StoredCoordinates, n_points: int, factors: NDArray[np.float64]) -> str:
    """Return a sentence on coordinates that are too large for the type that they are stored in.

    ``rows`` returns x, y and z of a range of rows as stored, ``factors`` convert them to metres. Empty where
    neighbouring numbers are less than `LARGEST_STEP` apart at half of the sampled points.
    """
    if not any(_is_narrow(values) for values in rows(0, min(1, n_points))):
        return ""
    starts = sorted({round(part * max(n_points - SAMPLE, 0)) for part in np.linspace(0, 1, SAMPLES)})
    parts = [rows(start, min(start + SAMPLE, n_points)) for start in starts]
    steps = {}
    for columns, factor in zip(zip(*parts, strict=True), factors, strict=True):
        values = np.concatenate(columns)
        values = values[np.isfinite(values)]
        if _is_narrow(values) and len(values):
            with np.errstate(over="ignore"):
                step = float(np.median(np.abs(np.spacing(values)))) * float(factor)
            steps[step] = 8 * values.dtype.itemsize
    step = max(steps, default=0.0)
    if not LARGEST_STEP < step < np.inf:
        return ""
    return (
        f"coordinates are stored as floats of {steps[step]} bits in steps of {step:g} m, too coarse for objects: "
        "export them with 64 bits, or relative to an offset"
    )


def _is_narrow(values: NDArray) -> bool:
    return values.dtype.kind == "f" and values.dtype.itemsize < 8
