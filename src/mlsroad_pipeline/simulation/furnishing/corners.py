"""Junctions and crossings: clearances, signals, signs and queues, and the furniture of side streets."""

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.furnishing import catalogue
from mlsroad_pipeline.simulation.furnishing.placement import Site
from mlsroad_pipeline.simulation.model.meshes import Design
from mlsroad_pipeline.simulation.street.ground import (
    CONTROL,
    HALF_WIDTH,
    RADIUS,
    SIDE,
    SIGNALS,
    SKEW,
    STATION,
    STOP,
    arm_place,
    hold_line,
)

_SIGNS = {"stop": ("octagonal_sign",), "give_way": ("yield_sign",), "zebra": ("square_sign", "rectangular_sign"),
          "name": ("street_name_sign",)}  # fmt: skip


def sign(site: Site, meaning: str) -> Design:
    """Choose a traffic sign for a purpose, a key of `_SIGNS`."""
    return catalogue.choose("traffic_sign", site.rng, str(site.rng.choice(_SIGNS[meaning])))


class SideStreet:
    """Side street with the measures that its furniture needs."""

    def __init__(self, site: Site, arm: NDArray[np.float64]) -> None:
        section = site.street.ground.section[int(arm[SIDE])]
        self.arm, self.half, self.way = arm, float(section[0]), 1.0 if arm[SIDE] == 0 else -1.0
        self.width = float(arm[HALF_WIDTH])  # half of that of its carriageway, metres
        self.zone = float(section[2]) + max(float(section[3]) / 2, 0.4)  # from the curb to trees and lamps, metres
        self.outward = float(self.way * (np.pi / 2 - np.arctan(arm[SKEW])))  # direction relative to the street's

    def place(self, t: float, q: float) -> tuple[float, float]:
        """Return station and offset of a place along and across the side street."""
        return arm_place(self.arm, self.half, t, q)


def _side_streets(site: Site) -> list[SideStreet]:
    """Return the side streets that join within a block."""
    arms = site.street.ground.arms
    return [SideStreet(site, arm) for arm in arms[(arms[:, STATION] >= site.start) & (arms[:, STATION] < site.end)]]


def keep_clear(site: Site) -> None:
    """Keep crossings, driveways and side streets free."""
    ground = site.street.ground
    for at, half in ground.crossings:
        if site.start - 10 < at < site.end + 10:
            for side, sign_of in ((0, 1.0), (1, -1.0)):
                line = ground.property_line(side)
                inner = float(ground.section[side, 0]) - 2.2
                site.block_out(float(at), sign_of * (line + inner) / 2, float(half) + 0.3, (line - inner) / 2)
    for lot in site.street.lots:
        if lot.arm < 0 and site.start - 5 < lot.driveway < site.end + 5:
            line, half = ground.property_line(lot.side), float(ground.section[lot.side, 0])
            middle = (line + half) / 2 * (1 if lot.side == 0 else -1)
            site.block_out(lot.driveway, middle, 1.9, (line - half) / 2 + 1.2)
    for road in _side_streets(site):
        depth = 55.0 - road.half
        site.block_out(*road.place(depth / 2, 0.0), depth / 2 + 0.5, road.width - 0.05, road.outward)


def furnish(site: Site) -> None:
    """Place signals, signs and waiting cars at junctions, signals or signs at crossings."""
    for road in _side_streets(site):
        _hold(site, road)
    stations = site.street.ground.arms[:, STATION]
    for at, half in site.street.ground.crossings:
        if not site.start + 4 < at < site.end - 4:
            continue
        near = np.flatnonzero(np.abs(stations - at) < 20)
        signalled = site.street.ground.arms[near[0], CONTROL] == SIGNALS if len(near) else site.rng.random() < 0.4
        for side in (0, 1):
            _at_crossing(site, float(at), float(half), side, signalled=bool(signalled))


def _at_crossing(site: Site, at: float, half: float, side: int, *, signalled: bool) -> None:
    # Right-hand traffic approaches from lower stations on the right, from higher ones on the left.
    left = site.street.kerb_zone(side)
    for away in (0.7, 1.1, 1.6):
        station = at + (half + away) * (1 if side == 0 else -1)
        if signalled:
            design = catalogue.choose("traffic_light", site.rng)
            yaw = site.toward_road(left) + float(site.rng.normal(0, 0.03))
        else:
            design, yaw = sign(site, "zebra"), site.facing_traffic(left)
        if site.try_add(design, station, left, yaw, edge=(0.1, 12.0)) is not None:
            return


def _hold(site: Site, road: SideStreet) -> None:
    """Place the traffic control of a side street, its street name sign, and waiting cars."""
    rng, arm, entering = site.rng, road.arm, -road.way
    hold = hold_line(arm)
    s, left = road.place(max(hold, arm[RADIUS] + 0.4), entering * (road.width + road.zone))
    if arm[CONTROL] == SIGNALS:
        design, yaw = catalogue.choose("traffic_light", rng), road.outward + np.pi / 2 * road.way
    else:
        design, yaw = sign(site, "stop" if arm[CONTROL] == STOP else "give_way"), road.outward
    site.try_add(design, s, left, float(yaw + rng.normal(0, 0.04)), edge=(0.1, 12.0))
    s, left = road.place(road.zone + 0.3 * float(arm[RADIUS]), -entering * (road.width + arm[RADIUS]))
    site.try_add(sign(site, "name"), s, left, float(rng.uniform(0, 6.28)), edge=(0.1, 12.0))
    at = hold + 0.5
    for _ in range(int(rng.poisson(0.9 * site.parameters.traffic))):
        car = catalogue.choose("car", rng)
        mesh = car.build(rng)
        long = float(np.ptp(mesh.vertices[:, 0]))
        s, left = road.place(at + long / 2, entering * road.width / 2)
        site.add(car, mesh, s, left, float(road.outward + np.pi + rng.normal(0, 0.02)), tilt=True)
        at += long + float(rng.uniform(1.0, 2.5))


def furnish_side_streets(site: Site) -> None:
    """Place parked cars, lamps, trees and people along side streets."""
    rng, parameters = site.rng, site.parameters
    for road in _side_streets(site):
        for flank in (-1.0, 1.0):
            rows = []
            for label, share, gap in (("tree", 0.7 * parameters.trees, 9.0), ("light_pole", 0.7, 28.0)):
                places = np.arange(16.0 + rng.uniform(0, 4), 44.0, gap)
                rows += [(label, float(t)) for t in places[rng.random(len(places)) < share]]
            rows += [("person", float(rng.uniform(8, 40))) for _ in range(rng.poisson(0.5 * parameters.people))]
            rows += [("bin", float(rng.uniform(12, 40))) for _ in range(rng.poisson(0.7 * parameters.clutter))]
            for label, t in rows:
                design = catalogue.choose(label, rng)
                off = road.zone if label in ("tree", "light_pole") else road.zone + 1.2
                s, left = road.place(t, flank * (road.width + off))
                yaw = road.outward - flank * road.way * np.pi / 2 * (-1 if label == "light_pole" else 1)
                site.try_add(design, s, left, yaw, edge=(0.1, 12.0))
            if flank * road.way > 0 and road.width > 3.3:
                for t in np.arange(18.0, 44.0, 6.2):
                    if rng.random() < 0.5 * parameters.parked:
                        s, left = road.place(float(t), flank * (road.width - 1.1))
                        design = catalogue.choose("car", rng)
                        # Side streets are kept clear of all but cars.
                        site.add(design, design.build(rng), s, left, road.outward, tilt=True)
