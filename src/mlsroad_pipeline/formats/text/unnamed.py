"""Columns of a text file without names: colours, and first columns that are no x."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.text.rows import TextRows
from mlsroad_pipeline.formats.text.values import RowForm, parse_rows

SAMPLE = 20  # rows of a sample; there is one at the start, in the middle and at the end of a file
LEAST_ROWS = 30  # smallest number of sampled rows of which the first column may be their number
# Least values of eastings, northings and times, and least ratio of times to local coordinates.
FAR, FACTOR = 10_000.0, 10.0
GROWS = "its first column is read as x, but grows from row to row as times do; if it is no x, set columns by index"

COUNTS = (
    "{}, line {}: its first column, {:g}, counts the rows and is no x; set columns by index, such as "
    "{{x: 1, y: 2, z: 3}}"
)


def interpret(rows: TextRows, form: RowForm) -> tuple[dict[str, Any], tuple[str, ...], str]:
    """Return a mapping of unnamed columns behind x, y and z, sentences for the user, and the message of an error.

    Colours are three whole numbers up to 255 right after x, y, z or after one more column, which is the intensity where
    it is not negative. The message is not empty where the first of more than three columns is the number of the row.
    """
    if form.width < 4:
        return {}, (), ""
    index, columns = _sampled(rows, form)
    if not columns:
        return {}, (), ""  # reading reports the row
    if len(index) >= LEAST_ROWS and _counts_rows(columns, index):
        return {}, (), COUNTS.format(rows.path, rows.first_line, columns[0][0])
    steps, apart = np.diff(columns[0]), np.diff(index)
    inside = steps[apart == 1]
    grows = len(inside) and (steps >= 0).all() and 2 * np.count_nonzero(inside > 0) > len(inside)
    return _colours(columns), (GROWS,) * bool(grows and _are_times(columns)), ""


def _counts_rows(columns: list[NDArray[np.float64]], index: NDArray[np.int64]) -> bool:
    """Return whether the first column numbers the rows: whole numbers before three columns that vary, x, y and z."""
    whole = columns[0][0] == np.floor(columns[0][0])
    return bool(whole and np.ptp(columns[0] - index) == 0 and all(np.ptp(values) > 0 for values in columns[1:4]))


def _are_times(columns: list[NDArray[np.float64]]) -> bool:
    """Return whether a growing first column holds times, and not the x of sorted points.

    Two columns of eastings and northings follow it, or its values are those of seconds of a week, or larger, and far
    above the coordinates that follow.
    """
    time, *others = (float(np.median(np.abs(values))) for values in columns[:3])
    return min(others) >= FAR or (time >= FAR and time >= FACTOR * max(others))


def _sampled(rows: TextRows, form: RowForm) -> tuple[NDArray[np.int64], list[NDArray[np.float64]]]:
    starts = sorted({0, rows.n_rows // 2, max(rows.n_rows - SAMPLE, 0)})
    stops = [min(start + SAMPLE, rows.n_rows) for start in starts]
    try:
        parts = [
            parse_rows(rows.read(start, stop), form, path=rows.path, first_line=rows.first_line + start)
            for start, stop in zip(starts, stops, strict=True)
        ]
    except ReadError:
        return np.empty(0, np.int64), []
    index, once = np.unique(
        np.concatenate([np.arange(start, stop) for start, stop in zip(starts, stops, strict=True)]), return_index=True
    )
    return index, [np.concatenate(values)[once] for values in zip(*parts, strict=True)]


def _colours(columns: list[NDArray[np.float64]]) -> dict[str, Any]:
    for first in (3, 4):
        triple = columns[first : first + 3]
        if len(triple) == 3 and all(_is_byte(values) for values in triple) and max(v.max() for v in triple) > 1:
            guess: dict[str, Any] = {"rgb": [first, first + 1, first + 2]}
            if first == 4 and columns[3].min() >= 0:
                guess["intensity"] = 3
            return guess
    return {}


def _is_byte(values: NDArray[np.float64]) -> bool:
    with np.errstate(invalid="ignore"):
        return bool(((values >= 0) & (values <= 255) & (values == np.floor(values))).all())
