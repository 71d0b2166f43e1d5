"""Junctions and crossings: clearances, signals, signs and queues, and the furniture of side streets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.furnishing import catalogue
from mlsroad_pipeline.simulation.furnishing.placement import Site
from mlsroad_pipeline.simulation.model.meshes import Design
from mlsroad_pipeline.simulation.street.junctions import (
    CONTROL,
    HALF_WIDTH,
    RADIUS,
    SIDE,
    SIGNALS,
    SKEW,
    STATION,
    STOP,
    ZEBRA,
    ZEBRA_HALF,
    arm_place,
)

_SIGNS = {"stop": ("octagonal_sign",), "give_way": ("yield_sign",), "zebra": ("square_sign", "rectangular_sign"),
          "name": ("street_name_sign",)}  # fmt: skip


def sign(site: Site, meaning: str) -> Design:
    """Choose a traffic sign for a purpose, a key of `_SIGNS`."""
    return catalogue.choose("traffic_sign", site.rng, str(site.rng.choice(_SIGNS[meaning])))


def arms_of(site: Site) -> list[NDArray[np.float64]]:
    """Return the side streets that join within a block."""
    arms = site.street.ground.arms
    return list(arms[(arms[:, STATION] >= site.start) & (arms[:, STATION] < site.end)])


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
    for arm in arms_of(site):
        half = float(ground.section[int(arm[SIDE]), 0])
        depth = 55.0 - half
        s, left = arm_place(arm, half, depth / 2, 0.0)
        way = 1.0 if arm[SIDE] == 0 else -1.0
        angle = way * (np.pi / 2 - np.arctan(arm[SKEW]))
        site.block_out(s, left, depth / 2 + 0.5, float(arm[HALF_WIDTH]) - 0.05, float(angle))


def furnish(site: Site) -> None:
    """Place signals, signs and waiting cars at junctions, signals or signs at crossings."""
    for arm in arms_of(site):
        _hold(site, arm)
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


def _hold(site: Site, arm: NDArray[np.float64]) -> None:
    """Place the traffic control of a side street, its street name sign, and waiting cars."""
    ground, rng = site.street.ground, site.rng
    side = int(arm[SIDE])
    half, way = float(ground.section[side, 0]), 1.0 if side == 0 else -1.0
    zone = float(ground.section[side, 2]) + max(float(ground.section[side, 3]) / 2, 0.4)
    entering = -1.0 if side == 0 else 1.0
    hold = arm[ZEBRA] + ZEBRA_HALF + 1.0 if arm[ZEBRA] > 0 else 0.75 * arm[RADIUS]
    outward = way * (np.pi / 2 - np.arctan(arm[SKEW]))
    near = entering * (arm[HALF_WIDTH] + zone)
    t = max(hold, arm[RADIUS] + 0.4)
    s, left = arm_place(arm, half, t, near)
    if arm[CONTROL] == SIGNALS:
        design, yaw = catalogue.choose("traffic_light", rng), outward + np.pi / 2 * way
    else:
        design, yaw = sign(site, "stop" if arm[CONTROL] == STOP else "give_way"), outward
    site.try_add(design, s, left, float(yaw + rng.normal(0, 0.04)), edge=(0.1, 12.0))
    s, left = arm_place(arm, half, zone + 0.3 * float(arm[RADIUS]), -entering * (arm[HALF_WIDTH] + arm[RADIUS]))
    site.try_add(sign(site, "name"), s, left, float(rng.uniform(0, 6.28)), edge=(0.1, 12.0))
    at = hold + 0.5
    for _ in range(int(rng.poisson(0.9 * site.parameters.traffic))):
        car = catalogue.choose("car", rng)
        mesh = car.build(rng)
        long = float(np.ptp(mesh.vertices[:, 0]))
        s, left = arm_place(arm, half, at + long / 2, entering * float(arm[HALF_WIDTH]) / 2)
        yaw = float(outward + np.pi + rng.normal(0, 0.02))
        site.add(car, mesh, s, left, yaw, tilt=True)
        at += long + float(rng.uniform(1.0, 2.5))


def furnish_side_streets(site: Site) -> None:
    """Place parked cars, lamps, trees and people along side streets."""
    rng, ground = site.rng, site.street.ground
    for arm in arms_of(site):
        side = int(arm[SIDE])
        half, way = float(ground.section[side, 0]), 1.0 if side == 0 else -1.0
        zone = float(ground.section[side, 2]) + max(float(ground.section[side, 3]) / 2, 0.4)
        outward = way * (np.pi / 2 - np.arctan(arm[SKEW]))
        for flank in (-1.0, 1.0):
            rows = []
            for label, share, gap in (("tree", 0.7 * site.parameters.trees, 9.0), ("light_pole", 0.7, 28.0)):
                places = np.arange(16.0 + rng.uniform(0, 4), 44.0, gap)
                rows += [(label, float(t)) for t in places[rng.random(len(places)) < share]]
            rows += [("person", float(rng.uniform(8, 40))) for _ in range(rng.poisson(0.5 * site.parameters.people))]
            rows += [("bin", float(rng.uniform(12, 40))) for _ in range(rng.poisson(0.7 * site.parameters.clutter))]
            for label, t in rows:
                design = catalogue.choose(label, rng)
                off = zone if label in ("tree", "light_pole") else zone + 1.2
                s, left = arm_place(arm, half, float(t), flank * (float(arm[HALF_WIDTH]) + off))
                yaw = outward - flank * way * np.pi / 2 * (-1 if label == "light_pole" else 1)
                site.try_add(design, s, left, float(yaw), edge=(0.1, 12.0))
            if flank * way > 0 and arm[HALF_WIDTH] > 3.3:
                for t in np.arange(18.0, 44.0, 6.2):
                    if rng.random() < 0.5 * site.parameters.parked:
                        s, left = arm_place(arm, half, float(t), flank * (float(arm[HALF_WIDTH]) - 1.1))
                        design = catalogue.choose("car", rng)
                        mesh = design.build(rng)
                        # Side streets are kept clear of all but cars.
                        site.add(design, mesh, s, left, float(outward), tilt=True)
