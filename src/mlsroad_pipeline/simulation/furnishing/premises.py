"""Objects beyond the property line: buildings, fences, walls and hedges, gardens."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from mlsroad_pipeline.simulation.furnishing import buildings, catalogue
from mlsroad_pipeline.simulation.furnishing.placement import Site
from mlsroad_pipeline.simulation.plants.hedges import hedge, thicket
from mlsroad_pipeline.simulation.street.junctions import HALF_WIDTH, SIDE, SKEW, STATION, arm_place
from mlsroad_pipeline.simulation.street.lots import Lot

_PIECE = 4.0  # length of a piece of fence, wall or hedge, metres


class Frame:
    """Frame of a lot: along its own street, and away from that street's property line."""

    def __init__(self, site: Site, lot: Lot) -> None:
        ground = site.street.ground
        self.arm = ground.arms[lot.arm] if lot.arm >= 0 else None
        self.way = 1.0 if lot.side == 0 else -1.0
        if self.arm is None:
            self.line = ground.property_line(lot.side)
            self.yaw = 0.0 if lot.side == 0 else np.pi
            return
        side = int(self.arm[SIDE])
        self.half = float(ground.section[side, 0])
        self.line = float(self.arm[HALF_WIDTH] + ground.section[side, 2:].sum())
        outward = (1.0 if side == 0 else -1.0) * (np.pi / 2 - np.arctan(self.arm[SKEW]))
        # Fronts face the side street.
        turned = outward if (lot.side == 0) == (side == 1) else outward + np.pi
        self.yaw = float(turned)

    def place(self, along: float, beyond: float) -> tuple[float, float]:
        """Return station and offset of a place `beyond` metres behind the property line."""
        if self.arm is None:
            return along, self.way * (self.line + beyond)
        return arm_place(self.arm, self.half, along, self.way * (self.line + beyond))


def lots_of(site: Site) -> list[tuple[Lot, Frame]]:
    """Return the lots of a block with their frames."""
    arms = site.street.ground.arms
    lots = []
    for lot in site.street.lots:
        s = (lot.start + lot.end) / 2 if lot.arm < 0 else float(arms[lot.arm, STATION])
        if site.start <= s < site.end:
            lots.append((lot, Frame(site, lot)))
    return lots


def build(site: Site) -> None:
    """Build the houses of a block and the boundaries of its lots."""
    for lot, frame in lots_of(site):
        if lot.kind != "open":
            _house(site, lot, frame)
        _boundary(site, lot, frame)


def _house(site: Site, lot: Lot, frame: Frame) -> None:
    rng, length = site.rng, lot.end - lot.start
    row = lot.kind == "row"
    gap = 0.0 if row else float(rng.uniform(1.0, 3.0))
    plinth = float(rng.uniform(0.15, 0.3)) if row else float(rng.choice([0.0, 0.3, 0.6, 0.9]))
    mesh = buildings.building(
        rng, max(length - gap, 4.0), shop=row and rng.random() < 0.45, plinth=0.0 if row else plinth,
        storeys=site.parameters.storeys,
    )  # fmt: skip
    s, left = frame.place((lot.start + lot.end) / 2, lot.setback)
    site.add(("building", "building"), mesh, s, left, frame.yaw, numbered=False)


def _boundary(site: Site, lot: Lot, frame: Frame) -> None:
    """Place one design of fence, wall or hedge along a lot, in pieces that follow the ground."""
    if lot.boundary == "none":
        return
    gate = (lot.driveway - 1.6, lot.driveway + 1.6) if np.isfinite(lot.driveway) else (lot.end, lot.end)
    state = int(site.rng.integers(2**31))
    make = {"fence": buildings.fence, "wall": buildings.wall, "hedge": hedge}[lot.boundary]
    if lot.boundary == "hedge" and site.parameters.greenery > 0:
        _untrimmed(site, lot, frame, gate)
        return
    for low, high in ((lot.start, gate[0]), (gate[1], lot.end)):
        if high - low < 0.6:
            continue
        for a, b in pairwise(np.linspace(low, high, max(round((high - low) / _PIECE), 1) + 1)):
            # The same state for every piece: they are of one design.
            mesh = make(np.random.default_rng(state), float(b - a))
            s, left = frame.place(float(a + b) / 2, 0.3)
            site.add((lot.boundary, lot.boundary), mesh, s, left, frame.yaw, tilt=True, numbered=False)


def _untrimmed(site: Site, lot: Lot, frame: Frame, gate: tuple[float, float]) -> None:
    """Plant a hedge that is trimmed rarely, as high as the street's greenery makes it."""
    rng = np.random.default_rng(int(site.rng.integers(2**31)))
    share = site.parameters.greenery
    height, depth = rng.uniform(0.8, 1.6 + 1.4 * share), rng.uniform(0.6, 0.9 + 0.9 * share)
    for low, high in ((lot.start, gate[0]), (gate[1], lot.end)):
        if high - low < 0.6:
            continue
        for a, b in pairwise(np.linspace(low, high, max(round((high - low) / _PIECE), 1) + 1)):
            mesh = thicket(rng, float(b - a), height=float(height), depth=float(depth))
            s, left = frame.place(float(a + b) / 2, 0.1 + float(depth) / 2)
            site.add(("hedge", "hedge"), mesh, s, left, frame.yaw, tilt=True, numbered=False)


def plant_gardens(site: Site) -> None:
    """Plant trees, palms and shrubs in front gardens and on open land."""
    rng, parameters = site.rng, site.parameters
    weights = np.array([parameters.trees, parameters.palms, 2.0 * parameters.shrubs])
    if weights.sum() == 0:
        return
    for lot, frame in lots_of(site):
        deep = lot.setback - 1.2 if lot.kind == "house" else 14.0 if lot.kind == "open" else 0.0
        if deep <= 1.0:
            continue
        count = int(rng.integers(1, 5 if deep < 8 else 8))
        for label in rng.choice(["tree", "palm", "brushwood"], count, p=weights / weights.sum()):
            along, beyond = rng.uniform(lot.start + 0.8, lot.end - 0.8), 0.9 + rng.uniform(0.2, deep)
            s, left = frame.place(float(along), float(beyond))
            design = catalogue.choose(str(label), rng)
            site.try_add(design, s, left, float(rng.uniform(0, 6.28)), edge=(0.3, 60.0))
