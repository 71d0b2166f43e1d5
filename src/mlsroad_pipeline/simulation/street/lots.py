"""Lots beside a street: their use, and their ends at junctions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.parameters.street_parameters import StreetParameters
from mlsroad_pipeline.simulation.street.junctions import HALF_WIDTH, RADIUS, SIDE, SKEW, STATION

_BEHIND_CORNER = 22.0  # land of the main street's lots, from the property line on, metres
_END = 52.0  # side streets are built on up to here, metres from the main street's axis


@dataclass(frozen=True)
class Lot:
    """Lot beside the street, or beside a side street."""

    side: int  # 0 is left, 1 is right; of a side street, 0 is the side ahead along the main street
    # start, end: stations, metres; of a side street, distances beyond the main carriageway
    start: float
    end: float
    kind: str  # ``"row"`` (facade at the pavement), ``"house"`` (behind a front garden) or ``"open"``
    boundary: str  # Boundary on the property line: ``"fence"``, ``"wall"``, ``"hedge"`` or ``"none"``
    setback: float  # Distance of the building from the property line, metres
    driveway: float  # Station of the driveway's middle, NaN without one
    arm: int = -1  # Row of the side street in `Ground.arms`; -1 is the main street


def free_land(
    side: int, start: float, end: float, section: NDArray[np.float64], arms: NDArray[np.float64]
) -> list[tuple[float, float]]:
    """Return start and end of the stretches of one side of a street between its side streets; side 0 is left."""
    width = float(section[side, 2:].sum())
    stretches, at = [], start
    for arm in arms[arms[:, SIDE] == side]:
        # Corners of buildings keep clear of the rounded corner of the pavement; skewed streets need more room.
        margin = arm[HALF_WIDTH] + width + 0.45 * max(arm[RADIUS] - width, 0.0) + abs(arm[SKEW]) * 20.0 + 0.6
        stretches.append((at, float(arm[STATION] - margin)))
        at = float(arm[STATION] + margin)
    return [*stretches, (at, end)]


def _drawn(
    rng: np.random.Generator, side: int, stretch: tuple[float, float], parameters: StreetParameters, arm: int,
    shares: NDArray[np.float64], edges: NDArray[np.float64],
) -> list[Lot]:  # fmt: skip
    lots, (at, end) = [], stretch
    while end - at > 5.0:
        stop = at + rng.uniform(9, 20)
        if end - stop < 6.0:
            stop = end
        kind = str(rng.choice(("row", "house", "open"), p=shares))
        if rng.random() >= parameters.buildings or stop - at > 26.0:
            kind = "open"
        boundary = "none" if kind == "row" else str(rng.choice(("fence", "wall", "hedge", "none"), p=edges))
        if parameters.boundaries < 1.0 and rng.random() >= parameters.boundaries:
            boundary = "none"
        setback = rng.uniform(0.1, 0.5) if kind == "row" else rng.uniform(3.5, 7.5)
        if kind != "row" and parameters.front_yard > 0:
            setback = parameters.front_yard * rng.uniform(0.7, 1.3)
        has_driveway = arm < 0 and kind != "row" and rng.random() < 0.6 * min(parameters.buildings, 1.0)
        driveway = rng.uniform(at + 3.2, stop - 3.2) if has_driveway and stop - at > 7 else np.nan
        lots.append(Lot(side, at, stop, kind, boundary, setback, float(driveway), arm))
        at = stop
    return lots


def draw_lots(
    rng: np.random.Generator, side: int, start: float, end: float, section: NDArray[np.float64],
    arms: NDArray[np.float64], parameters: StreetParameters,
) -> list[Lot]:  # fmt: skip
    """Draw the lots on one side of a street, then those on both sides of its side streets there."""
    shares, edges = rng.dirichlet([2.5, 2.5, 0.8]), rng.dirichlet([2.0, 2.0, 2.0, 0.7])
    if parameters.facades >= 0:
        shares = np.array([parameters.facades, 1.0 - parameters.facades, 0.0])
    if parameters.hedges >= 0:
        edges = np.append((1.0 - parameters.hedges) * edges[:2] / edges[:2].sum(), [parameters.hedges, 0.0])
    lots: list[Lot] = []
    for stretch in free_land(side, start, end, section, arms):
        lots += _drawn(rng, side, stretch, parameters, -1, shares, edges)
    behind = float(section[side, 2:].sum()) + _BEHIND_CORNER
    for k in np.flatnonzero(arms[:, SIDE] == side):
        for flank in range(2):
            stretch = (behind, _END - float(section[side, 0]))
            lots += _drawn(rng, flank, stretch, parameters, int(k), shares, edges)
    return lots
