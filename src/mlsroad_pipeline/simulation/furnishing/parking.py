"""Parked vehicles in painted bays, and bicycles and motorcycles at the curb, in rows and at walls.

Two-wheelers beyond a factor of 1 are drawn last, from random numbers of their own, so that the rest of a street does
not change.
"""

import numpy as np

from mlsroad_pipeline.simulation.furnishing import catalogue
from mlsroad_pipeline.simulation.furnishing.placement import Site
from mlsroad_pipeline.simulation.street.cover import BAY, SLANTED_BAY
from mlsroad_pipeline.simulation.street.ground import Nearby, bay_is_free, nearby
from mlsroad_pipeline.simulation.street.street import BLOCK, Street, generator

_KINDS, _SHARES = ("car", "van", "truck"), np.array([0.86, 0.12, 0.02])
_PARKED = 2.0  # parked two-wheelers per block at a factor of 1
_BICYCLES = 0.75  # share of bicycles among them
_TRIES = 12  # places tried for each
_ROOM = 8.0  # between successive cyclists, metres
_RIDDEN = 0.45  # cyclists per block


def park(site: Site) -> None:
    """Fill the bays of a block; bays at driveways, junctions and crossings stay free."""
    ground = site.street.ground
    slant = float(ground.shape[6])
    pitch = SLANTED_BAY if slant > 0 else BAY
    for side, way in ((0, 1.0), (1, -1.0)):
        half, depth = (float(v) for v in ground.section[side, :2])
        if depth == 0:
            continue
        for k in range(int(np.ceil(site.start / pitch)), int(np.floor(site.end / pitch))):
            free = all(
                bay_is_free(s, side, ground, nearby(s, ground, Nearby(0, 0, 0))) for s in (k * pitch, (k + 1) * pitch)
            )
            if free and site.rng.random() < site.parameters.parked:
                _one(site, (k + 0.5) * pitch - way * slant * depth / 2, way * (half - depth / 2), slant, depth)


def _one(site: Site, s: float, left: float, slant: float, depth: float) -> None:
    rng, way = site.rng, 1.0 if left >= 0 else -1.0
    share = _SHARES[:1] if slant > 0 else _SHARES
    design = catalogue.choose(_KINDS[int(rng.choice(len(share), p=share / share.sum()))], rng)
    mesh = design.build(rng)
    long = float(np.ptp(mesh.vertices[:, 0]))
    if slant > 0:
        yaw = float(np.arctan2(way, -way * slant)) + (np.pi if rng.random() < 0.15 else 0.0)
        if long > 4.95:
            return
    else:
        # Right-hand traffic: few park against it.
        yaw = (np.pi if left >= 0 else 0.0) + (np.pi if rng.random() < 0.1 else 0.0)
        s += float(rng.normal(0, 0.15))
        if long > BAY - 0.3:
            return
    wide = float(np.ptp(mesh.vertices[mesh.vertices[:, 2] < 0.9, 1]))
    # A slanted car takes up more of its bay.
    askew = float(np.clip(rng.normal(0, 0.015), -0.03, 0.03))
    slack = max((depth - wide - abs(askew) * long) / 2 - 0.04, 0.0) if slant == 0 else 0.05
    left += float(np.clip(rng.normal(0, 0.08), -slack, slack))
    yaw += askew if slack > 0 else 0.0
    if site.fits(site.footprint(mesh, s, left, yaw)):
        site.add(design, mesh, s, left, yaw, tilt=True)


def is_left_out(rng: np.random.Generator, share: float) -> bool:
    """Return whether a two-wheeler is dropped at a share below 1; draws no random number at shares of 1 and more."""
    return share < 1.0 and bool(rng.random() >= share)


def park_two_wheelers(site: Site) -> None:
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


def _spot(site: Site, rng: np.random.Generator, label: str, side: int, *, single: bool) -> tuple[float, float]:
    """Return offset and direction, relative to the street's, of a place for one two-wheeler or for a row."""
    half, _, curb, _, _ = (float(v) for v in site.street.ground.section[side])
    way = 1.0 if side == 0 else -1.0
    if not single:
        # Side by side, facing the road or away from it.
        left = way * (half + curb + float(rng.uniform(1.05, 1.3)))
        return left, site.toward_road(left) + float(rng.choice([0.0, np.pi]))
    along = float(rng.choice([0.0, np.pi])) + float(rng.normal(0, 0.1))
    if label == "bicycle" and rng.random() < 0.5:
        left = site.street.ground.property_line(side) - float(rng.uniform(0.35, 0.5))
        return way * left, along
    return site.street.kerb_zone(side) + float(rng.normal(0, 0.06)), along


def _row(site: Site, rng: np.random.Generator, label: str, size: int) -> int:
    """Park two-wheelers side by side from one place on and return how many fitted."""
    side = int(rng.integers(2))
    left, heading = _spot(site, rng, label, side, single=size == 1)
    s = float(rng.uniform(site.start + 1, site.end - 1))
    edge = 0.05, float(site.street.ground.section[side, 2:].sum()) + 0.2
    parked = 0
    for _ in range(size):
        design = catalogue.choose(label, rng)
        mesh = design.build(rng)
        yaw = heading + float(rng.normal(0, 0.05))
        if site.try_add(design, s, left, yaw, edge=edge, tilt=label == "bicycle", mesh=mesh) is None:
            break
        parked += 1
        s += float(np.ptp(mesh.vertices[:, 1])) + float(rng.uniform(0.1, 0.35))
    return parked


def cyclists(street: Street, block: int, taken: list[float]) -> tuple[np.random.Generator, list[float]]:
    """Return generator and stations of further cyclists in a block, all of one speed; `taken` are those of others."""
    rng = generator(street.seed, 32, block)
    excess = street.parameters.two_wheelers - 1.0
    if excess <= 0:
        return rng, []
    count = int(rng.poisson(_RIDDEN * street.parameters.traffic * excess))
    middles = np.arange(block * BLOCK + _ROOM / 2, (block + 1) * BLOCK - _ROOM / 4, _ROOM)
    free = [float(m) for m in middles if all(abs(m - station) > _ROOM * 0.75 for station in taken)]
    chosen = np.sort(rng.permutation(len(free))[:count])
    return rng, [free[k] + float(rng.uniform(-2.0, 2.0)) for k in chosen]
