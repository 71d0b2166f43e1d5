"""Parked vehicles in painted bays."""

from __future__ import annotations

import numpy as np

from mlsroad_pipeline.simulation.furnishing import catalogue
from mlsroad_pipeline.simulation.furnishing.placement import Site
from mlsroad_pipeline.simulation.street.junctions import Nearby, bay_is_free, nearby
from mlsroad_pipeline.simulation.street.markings import BAY, SLANTED_BAY

_KINDS = ("car", "van", "truck")
_SHARES = (0.86, 0.12, 0.02)


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
                bay_is_free(s, side, ground.section, ground.arms, ground.crossings,
                            nearby(s, ground.arms, ground.crossings, ground.manholes, Nearby(0, 0, 0)))
                for s in (k * pitch, (k + 1) * pitch)
            )  # fmt: skip
            if free and site.rng.random() < site.parameters.parked:
                _one(site, (k + 0.5) * pitch - way * slant * depth / 2, way * (half - depth / 2), slant, depth)


def _one(site: Site, s: float, left: float, slant: float, depth: float) -> None:
    rng, way = site.rng, 1.0 if left >= 0 else -1.0
    known = [(kind, share) for kind, share in zip(_KINDS, _SHARES, strict=True) if kind in catalogue.designs()]
    if slant > 0:
        known = known[:1]
    share = np.array([share for _, share in known])
    design = catalogue.choose(known[int(rng.choice(len(known), p=share / share.sum()))][0], rng)
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
