"""Centre line of a street: a smooth curve from which stations and offsets are counted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.simulation.model.compiled import leaf

STEP = 0.5  # Spacing of the tabulated centre line, metres


@dataclass(frozen=True)
class Alignment:
    """Centre line, tabulated every `STEP` metres of its length."""

    start: float  # Station of the first row, metres; station 0 is at the local origin
    # x, y (metres), heading (radians, counter-clockwise from x, continuous), its cosine and its sine at each station
    table: NDArray[np.float64]

    @classmethod
    def drawn(cls, rng: np.random.Generator, *, start: float, end: float, bends: float = 1.0) -> Alignment:
        """Draw a curve with radii above some 120 m over `bends`; a stream gives the same for any range of stations."""
        first = rng.uniform(0, 2 * np.pi)
        wavelength = rng.uniform([180.0, 350.0], [350.0, 900.0])
        amplitude = bends * rng.uniform(0.3, 1.0, 2) * wavelength * 0.5 / (2 * np.pi * 120.0)
        phase = rng.uniform(0, 2 * np.pi, 2)
        station = np.arange(start, end + STEP, STEP)
        turns = amplitude * np.sin(2 * np.pi * station[:, None] / wavelength + phase)
        heading = first + turns.sum(axis=1)
        middle = (heading[1:] + heading[:-1]) / 2
        xy = np.zeros((len(station), 2))
        np.cumsum(STEP * np.stack([np.cos(middle), np.sin(middle)], 1), axis=0, out=xy[1:])
        zero = -start / STEP
        row = int(zero)
        xy -= xy[row] + (zero - row) * (xy[row + 1] - xy[row])
        return cls(start, np.column_stack([xy, heading, np.cos(heading), np.sin(heading)]))

    def place(self, station: ArrayLike, offset: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return plane coordinates, (n, 2), and headings of the centre line at stations and offsets to the left."""
        s, left = np.broadcast_arrays(np.asarray(station, dtype=np.float64), np.asarray(offset, dtype=np.float64))
        grid = self.start + STEP * np.arange(len(self.table))
        x, y, heading = (np.interp(s, grid, self.table[:, k]) for k in range(3))
        return np.stack([x - left * np.sin(heading), y + left * np.cos(heading)], axis=-1), heading

    def locate(self, xy: ArrayLike, *, near: float = 0.0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return stations and offsets of places within 100 m of the axis, searched from the station `near` on."""
        points = np.ascontiguousarray(xy, dtype=np.float64)
        return _locate(points, self.table, self.start, near)


@leaf
def interpolate(table: NDArray[np.float64], start: float, s: float) -> tuple[float, float, float]:
    """Return x, y and heading at a station, constant beyond the ends."""
    u = min(max((s - start) / STEP, 0.0), len(table) - 1.000001)
    k = int(u)
    f = u - k
    return (
        table[k, 0] + f * (table[k + 1, 0] - table[k, 0]),
        table[k, 1] + f * (table[k + 1, 1] - table[k, 1]),
        table[k, 2] + f * (table[k + 1, 2] - table[k, 2]),
    )


@leaf
def locate_one(
    x: float, y: float, table: NDArray[np.float64], start: float, near: float, close: float
) -> tuple[float, float]:
    """Return station and offset of a point by Newton steps along the tangent, until one is shorter than `close`."""
    s = near
    left = 0.0
    for _ in range(30):
        u = min(max((s - start) / STEP, 0.0), len(table) - 1.000001)
        k = int(u)
        f = u - k
        turn = table[k + 1, 2] - table[k, 2]
        # Within a step the heading turns by some hundredths of a radian: three terms of the series are exact to 1e-10.
        small = f * turn
        flat, steep = 1.0 - small * small * (0.5 - small * small / 24.0), small * (1.0 - small * small / 6.0)
        c, n = table[k, 3] * flat - table[k, 4] * steep, table[k, 4] * flat + table[k, 3] * steep
        dx = x - table[k, 0] - f * (table[k + 1, 0] - table[k, 0])
        dy = y - table[k, 1] - f * (table[k + 1, 1] - table[k, 1])
        ahead, left = dx * c + dy * n, dy * c - dx * n
        # On the inside of a bend a step along the tangent is a longer one along the curve.
        s += ahead / max(1.0 - turn * left / STEP, 0.3)
        # The error of a step is its length times the turn within it.
        if abs(ahead) < close:
            break
    return s, left


@njit(cache=True, nogil=True, error_model="numpy")
def _locate(
    xy: NDArray[np.float64], table: NDArray[np.float64], start: float, near: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    s, left = np.empty(len(xy)), np.empty(len(xy))
    guess = near
    for i in range(len(xy)):
        s[i], left[i] = locate_one(xy[i, 0], xy[i, 1], table, start, guess, 0.01)
        guess = s[i]
    return s, left
