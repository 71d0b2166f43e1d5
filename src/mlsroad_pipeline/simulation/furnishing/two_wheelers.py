"""Further bicycles and motorcycles: parked at the curb, in rows and at walls, and ridden.

They are drawn last, from random numbers of their own, so that the rest of a street does not change.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mlsroad_pipeline.simulation.furnishing import catalogue
from mlsroad_pipeline.simulation.furnishing.placement import Site
from mlsroad_pipeline.simulation.street.street import BLOCK, Street, generator

_PARKED = 2.0  # parked two-wheelers per block at a factor of 1
_BICYCLES = 0.75  # share of bicycles among them
_TRIES = 12  # places tried for each
_ROOM = 8.0  # between successive cyclists, metres
_RIDDEN = 0.45  # cyclists per block


class _Spot(NamedTuple):
    """Place across the street."""

    left: float  # offset of the middle, metres
    yaw: float  # direction relative to the street's, radians
    across: bool  # whether two-wheelers stand side by side there, or one behind the other


def is_left_out(rng: np.random.Generator, share: float) -> bool:
    """Return whether a two-wheeler is dropped at a share below 1; draws no random number at shares of 1 and more."""
    return share < 1.0 and bool(rng.random() >= share)


def park(site: Site) -> None:
    """Park the two-wheelers beyond a factor of 1 on a furnished block, singly and in rows."""
    excess = site.parameters.two_wheelers - 1.0
    if excess <= 0:
        return
    rng = generator(site.street.seed, 18, site.block)
    missing = int(rng.poisson(_PARKED * excess))
    for _ in range(_TRIES * missing):
        if missing <= 0:
            return
        label = "bicycle" if rng.random() < _BICYCLES else "motorcycle"
        size = 1 if rng.random() < 0.4 else int(rng.integers(2, 6 if label == "bicycle" else 4))
        missing -= _row(site, rng, label, min(size, missing))


def _spot(site: Site, rng: np.random.Generator, label: str, side: int, *, single: bool) -> _Spot:
    half, _, curb, _, _ = (float(v) for v in site.street.ground.section[side])
    way = 1.0 if side == 0 else -1.0
    if not single:
        # Side by side, facing the road or away from it.
        left = way * (half + curb + float(rng.uniform(1.05, 1.3)))
        return _Spot(left, site.toward_road(left) + float(rng.choice([0.0, np.pi])), True)
    along = float(rng.choice([0.0, np.pi])) + float(rng.normal(0, 0.1))
    if label == "bicycle" and rng.random() < 0.5:
        left = site.street.ground.property_line(side) - float(rng.uniform(0.35, 0.5))
        return _Spot(way * left, along, False)
    return _Spot(site.street.kerb_zone(side) + float(rng.normal(0, 0.06)), along, False)


def _row(site: Site, rng: np.random.Generator, label: str, size: int) -> int:
    """Park two-wheelers side by side from one place on and return how many fitted."""
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
    """Return the generator and the stations of further cyclists in a block; they have one speed, so that none collides.

    `taken` are the stations of other cyclists on the same side, metres.
    """
    rng = generator(street.seed, 32, block)
    excess = street.parameters.two_wheelers - 1.0
    if excess <= 0:
        return rng, []
    count = int(rng.poisson(_RIDDEN * street.parameters.traffic * excess))
    middles = np.arange(block * BLOCK + _ROOM / 2, (block + 1) * BLOCK - _ROOM / 4, _ROOM)
    free = [float(m) for m in middles if all(abs(m - station) > _ROOM * 0.75 for station in taken)]
    chosen = np.sort(rng.permutation(len(free))[:count])
    return rng, [free[k] + float(rng.uniform(-2.0, 2.0)) for k in chosen]
