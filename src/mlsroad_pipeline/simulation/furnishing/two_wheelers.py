"""Bicycles and motorcycles beyond those that every street has: parked at the curb, in rows and at walls, and ridden.

All of it is drawn from random numbers of its own, after everything else: the rest of a street stays as it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mlsroad_pipeline.simulation.furnishing import catalogue
from mlsroad_pipeline.simulation.furnishing.placement import Site
from mlsroad_pipeline.simulation.street.street import BLOCK, Street, generator

_PARKED = 2.0  # two-wheelers that a plain town parks in a block
_BICYCLES = 0.75  # share of bicycles among them
_TRIES = 12  # places to look at for each that is wanted
_ROOM = 8.0  # between those who ride behind each other, metres
_RIDDEN = 0.45  # cyclists who are met in a block


class _Spot(NamedTuple):
    """A place across the street."""

    left: float  # offset of the middle, metres
    yaw: float  # direction relative to the street's, radians
    across: bool  # whether two-wheelers stand side by side there, or one behind the other


def is_left_out(rng: np.random.Generator, share: float) -> bool:
    """Tell whether a two-wheeler is left out of a street that has fewer than others; draws nothing in one that has not.

    Parameters
    ----------
    rng : numpy.random.Generator
        Decides.
    share : float
        Share of the two-wheelers that stay; 1 or more is all.

    Returns
    -------
    bool
        True where it is left out.
    """
    return share < 1.0 and bool(rng.random() >= share)


def park(site: Site) -> None:
    """Park what a street's multiplier asks for beyond 1, singly and in rows, where there is room.

    Parameters
    ----------
    site : Site
        The block, furnished.
    """
    excess = site.parameters.two_wheelers - 1.0
    if excess <= 0:
        return
    rng = generator(site.street.seed, 18, site.block)
    wanted = int(rng.poisson(_PARKED * excess))
    for _ in range(_TRIES * wanted):
        if wanted <= 0:
            return
        label = "bicycle" if rng.random() < _BICYCLES else "motorcycle"
        size = 1 if rng.random() < 0.4 else int(rng.integers(2, 6 if label == "bicycle" else 4))
        wanted -= _row(site, rng, label, min(size, wanted))


def _spot(site: Site, rng: np.random.Generator, label: str, side: int, *, single: bool) -> _Spot:
    half, _, curb, _, _ = (float(v) for v in site.street.ground.section[side])
    way = 1.0 if side == 0 else -1.0
    if not single:
        # Side by side, the front to the road or away from it.
        left = way * (half + curb + float(rng.uniform(1.05, 1.3)))
        return _Spot(left, site.toward_road(left) + float(rng.choice([0.0, np.pi])), True)
    along = float(rng.choice([0.0, np.pi])) + float(rng.normal(0, 0.1))
    if label == "bicycle" and rng.random() < 0.5:
        left = site.street.ground.property_line(side) - float(rng.uniform(0.35, 0.5))
        return _Spot(way * left, along, False)
    return _Spot(site.street.kerb_zone(side) + float(rng.normal(0, 0.06)), along, False)


def _row(site: Site, rng: np.random.Generator, label: str, size: int) -> int:
    """Park some two-wheelers beside each other from one place on, and tell how many found room."""
    side = int(rng.integers(2))
    spot = _spot(site, rng, label, side, single=size == 1)
    s = float(rng.uniform(site.start + 1, site.end - 1))
    edge = 0.05, float(site.street.ground.section[side, 2:].sum()) + 0.2
    parked = 0
    for _ in range(size):
        design = catalogue.choose(label, rng)
        mesh = design.build(rng)
        yaw = spot.yaw + float(rng.normal(0, 0.05))
        if site.try_add(design, s, spot.left, yaw, edge=edge, tilt=label == "bicycle", mesh=mesh) is None:
            break
        parked += 1
        s += float(np.ptp(mesh.vertices[:, 1])) + float(rng.uniform(0.1, 0.35))
    return parked


def cyclists(street: Street, block: int, taken: list[float]) -> tuple[np.random.Generator, list[float]]:
    """Return where further cyclists are met in a block; they ride at one speed, so that none runs into another.

    Parameters
    ----------
    street : Street
        The street.
    block : int
        Number of the block.
    taken : list of float
        Stations where others are met who ride on the same side, metres.

    Returns
    -------
    rng : numpy.random.Generator
        What they are drawn from.
    stations : list of float
        Metres.
    """
    rng = generator(street.seed, 32, block)
    excess = street.parameters.two_wheelers - 1.0
    if excess <= 0:
        return rng, []
    wanted = int(rng.poisson(_RIDDEN * street.parameters.traffic * excess))
    middles = np.arange(block * BLOCK + _ROOM / 2, (block + 1) * BLOCK - _ROOM / 4, _ROOM)
    free = [float(m) for m in middles if all(abs(m - station) > _ROOM * 0.75 for station in taken)]
    chosen = np.sort(rng.permutation(len(free))[:wanted])
    return rng, [free[k] + float(rng.uniform(-2.0, 2.0)) for k in chosen]
