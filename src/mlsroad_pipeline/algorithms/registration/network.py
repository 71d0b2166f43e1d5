"""Moves of recordings that agree best with the offsets of their pairs: a least-squares adjustment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.registration.offset import LEAST_TURN, Offset
from mlsroad_pipeline.algorithms.registration.surfaces import turn_of

LEAST = 0.04
"""Least offset in plan or in height that counts, metres: passes of one survey agree within 2 to 3 cm."""

TIED = 0.05
"""Standard error of the agreement of two recordings of one pass where nothing measures it, metres."""

FREE = (30.0, 30.0, 1e4)
"""Standard error of the move of a recording without any measurement, metres."""

FREE_TURN, FIXED = 0.1, 1e-6
"""Standard error of an unmeasured turn, radians, and of the recording that stays."""


@dataclass(frozen=True)
class Move:
    """A turn about the vertical through `pivot` (radians), then a shift (metres); tuples, as parameters of tasks."""

    shift: tuple[float, float, float]
    heading: float
    pivot: tuple[float, float, float]

    def apply(self, xyz: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return moved points, in the frame of `pivot`."""
        pivot = np.array(self.pivot)
        moved: NDArray[np.float64] = (xyz - pivot) @ turn_of(self.heading).T + pivot + self.shift
        return moved

    @property
    def is_small(self) -> bool:
        """Whether the move does not count."""
        return bool(np.hypot(*self.shift[:2]) < LEAST > abs(self.shift[2]) and abs(self.heading) < LEAST_TURN)


def adjust(
    middles: NDArray[np.float64],
    offsets: Mapping[tuple[int, int], Offset],
    same_pass: NDArray[np.integer],
) -> list[Move]:
    """Return the move of each recording; the one that most others agree with stays, the first among equals.

    A recording is turned about its middle. Files of one pass stay together where nothing measures them.
    """
    reference = 0
    for _ in range(2):
        values = _solve(middles, offsets, same_pass, reference)
        agree = [(np.abs(values[:, :3] - value[:3]).max(axis=1) < LEAST).sum() for value in values]
        reference = int(np.argmax(agree))
    return [
        Move(tuple(value[:3].tolist()), float(value[3]), tuple(middle.tolist()))
        for value, middle in zip(values, middles, strict=True)
    ]


def _solve(
    middles: NDArray[np.float64],
    offsets: Mapping[tuple[int, int], Offset],
    same_pass: NDArray[np.integer],
    reference: int,
) -> NDArray[np.float64]:
    """Return shift and turn of each recording; the reference stays."""
    n, rows, rest = len(middles), [], []

    def add(entries: Mapping[int, float], value: float, error: float) -> None:
        row = np.zeros(4 * n)
        row[list(entries)] = np.array(list(entries.values())) / error
        rows.append(row)
        rest.append(value / error)

    for u in range(n):
        for axis, free in enumerate((*FREE, FREE_TURN)):
            add({4 * u + axis: 1.0}, 0.0, FIXED if u == reference else free)
    for (a, b), offset in offsets.items():
        arms = [(offset.pivot - middles[u])[:2] for u in (a, b)]
        turned = np.isfinite(offset.heading_error)
        for axis in range(3):
            measured = np.isfinite(offset.shift[axis])
            if not measured and same_pass[a] != same_pass[b]:
                continue
            value, error = (offset.shift[axis], offset.error[axis]) if measured else (0.0, TIED)
            entries = {4 * b + axis: 1.0, 4 * a + axis: -1.0}
            if axis < 2 and measured:
                for u, sign, arm in ((a, -1.0, arms[0]), (b, 1.0, arms[1])):
                    entries[4 * u + 3] = sign * (-arm[1] if axis == 0 else arm[0])
            add(entries, value, max(error, 0.003))
        if turned:
            add({4 * b + 3: 1.0, 4 * a + 3: -1.0}, offset.heading, max(offset.heading_error, 1e-5))
    return np.linalg.lstsq(np.array(rows), np.array(rest), rcond=None)[0].reshape(n, 4)
