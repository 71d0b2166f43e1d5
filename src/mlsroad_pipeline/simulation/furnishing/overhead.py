"""Overhead lines: poles along one property line, sagging wires, lines to the houses; gantries over the road."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.simulation.furnishing import catalogue
from mlsroad_pipeline.simulation.furnishing.placement import Placed, Site
from mlsroad_pipeline.simulation.model.materials import material
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh, rotation_matrix
from mlsroad_pipeline.simulation.model.solids import tube
from mlsroad_pipeline.simulation.objects import utility_poles
from mlsroad_pipeline.simulation.objects.gantries import gantry
from mlsroad_pipeline.simulation.street.street import Street, generator

_WOODEN = ("wood_pole", "double_cross_arm_pole", "rack_pole")
_LINES = (*_WOODEN, "concrete_line_pole", "bracket_pole")
_SPECIALS, _SPECIAL = ("transformer_pole", "utility_pole_with_lamp"), 0.2
_GANTRIES = 0.2  # per block of a road of several lanes with a median


def dry_station(street: Street, s: float, left: float, *, least: float = 0.15) -> float:
    """Return the nearest station within 20 m that is `least` metres off curbs, driveways and crossings, or `s`."""
    side = 0 if left >= 0 else 1
    gates = np.array([lot.driveway for lot in street.lots if lot.side == side and lot.arm < 0])
    tried = s + np.array([0.0, *(k * d for d in np.arange(0.75, 20.0, 0.75) for k in (1, -1))])
    distance, _ = street.ground.edge(tried, np.full(len(tried), left))
    free = distance > least
    if np.isfinite(gates).any():
        free &= np.nanmin(np.abs(tried[:, None] - gates), axis=1) > 2.3
    if len(street.ground.crossings):
        zebra = street.ground.crossings
        free &= (np.abs(tried[:, None] - zebra[:, 0]) > zebra[:, 1] + 0.6).all(axis=1)
    return float(tried[np.argmax(free)])


def wire(start: ArrayLike, end: ArrayLike, sag: float, radius: float, rng: np.random.Generator) -> Mesh:
    """Return a wire of 24 straight pieces along a parabola, `sag` metres below the chord at its middle."""
    f = np.linspace(0, 1, 25)[:, None]
    path = np.asarray(start) + f * (np.asarray(end) - np.asarray(start))
    path[:, 2] -= 4 * sag * (f * (1 - f))[:, 0]
    return tube(path, radius, material("wire", "wire", rng), sides=4)


class _Line:
    """Line of utility poles with their stations and the attachment points of their wires."""

    def __init__(self, street: Street) -> None:
        rng = generator(street.seed, 12)
        self.street, self.side = street, int(rng.integers(2))
        self.exists = rng.random() < street.parameters.overhead_wires
        self.spacing = float(rng.uniform(29, 40))
        self.left = (street.ground.property_line(self.side) - 0.35) * (1 if self.side == 0 else -1)
        # All poles of a line are of one kind; some carry a transformer or a lamp.
        self.design = catalogue.choose("utility_pole", rng, str(rng.choice(_LINES)))
        self.sag, self.radius = float(rng.uniform(0.3, 0.9)), float(rng.uniform(0.008, 0.014))

    def station(self, k: int) -> float:
        return dry_station(self.street, k * self.spacing, self.left, least=0.5)

    def pole(self, k: int) -> tuple[Design, Mesh, NDArray[np.float64]]:
        rng = generator(self.street.seed, 13, k)
        design = self.design
        if rng.random() < _SPECIAL and design.name in _WOODEN:
            design = catalogue.choose("utility_pole", rng, str(rng.choice(_SPECIALS, p=[0.4, 0.6])))
        return design, *utility_poles.hung_pole(design.name, rng)

    def hang(self, k: int, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the attachment points of a pole, street-local coordinates."""
        base, heading = self.street.on_ground(self.station(k), self.left)
        yaw = heading + (-np.pi / 2 if self.left >= 0 else np.pi / 2)
        return points @ rotation_matrix(yaw, 0.0, 0.0).T + base


def utility_line(site: Site) -> None:
    """Place the utility poles of a block with wires to the next pole and to the houses."""
    line = _Line(site.street)
    if not line.exists:
        return
    for k in range(int(np.ceil(site.start / line.spacing)), int(np.ceil(site.end / line.spacing))):
        design, mesh, points = line.pole(k)
        pole = site.add(design, mesh, line.station(k), line.left, site.toward_road(line.left))
        here = line.hang(k, points)
        ahead = line.hang(k + 1, line.pole(k + 1)[2])
        count = min(len(here), len(ahead))
        for a, b in zip(here[:count], ahead[:count], strict=True):
            _wire(site, pole, a, b, line.sag * float(site.rng.uniform(0.8, 1.2)), line.radius)
        _to_houses(site, line, pole, k, here[-1])


def _to_houses(site: Site, line: _Line, pole: Placed, k: int, start: NDArray[np.float64]) -> None:
    """Hang a thin line from a pole to each house nearest to it."""
    ground = site.street.ground
    for lot in site.street.lots:
        middle = (lot.start + lot.end) / 2
        if lot.arm >= 0 or lot.kind == "open" or round(middle / line.spacing) != k:
            continue
        if lot.side != line.side and site.rng.random() < 0.5:
            continue
        left = (ground.property_line(lot.side) + lot.setback) * (1 if lot.side == 0 else -1)
        s = middle + float(site.rng.uniform(-0.3, 0.3)) * (lot.end - lot.start)
        end = site.street.on_ground(s, left)[0] + [0.0, 0.0, site.rng.uniform(2.5, 2.8)]
        _wire(site, pole, start, end, float(site.rng.uniform(0.2, 0.6)), 0.7 * line.radius)


def _wire(
    site: Site, pole: Placed, start: NDArray[np.float64], end: NDArray[np.float64], sag: float, radius: float
) -> None:
    span = wire(start - pole.base, end - pole.base, sag, radius, site.rng)
    site.add_at(("wire", "wire"), Mesh(span.vertices + pole.base, span.faces, span.attributes), start, end)


def over_the_road(site: Site) -> None:
    """Place gantries over some blocks of a road with a median."""
    if site.street.ground.shape[5] == 0:
        return
    number = int(_GANTRIES * site.parameters.gantries + 1 - site.rng.random())
    length = (site.end - site.start - 12) / max(number, 1)
    for k in range(number):
        _gantry(site, site.start + 6 + k * length, site.start + 6 + (k + 1) * length)


def _gantry(site: Site, first: float, last: float) -> None:
    """Place a gantry between two stations if both legs fit."""
    ground, rng = site.street.ground, site.rng
    s = dry_station(site.street, float(rng.uniform(first, last)), _leg(site, 0))
    if not site.start + 2 < s < site.end - 2:
        return
    legs = [np.array([s, _leg(site, side), 0.35, 0.35, 0.0]) for side in range(2)]
    near_arm = ground.edge([s, s], [legs[0][1], legs[1][1]])[0].min() < 0.5
    if near_arm or not all(site.fits(leg) for leg in legs):
        return
    mesh = gantry(rng, float(legs[0][1] - legs[1][1]))
    site.add(catalogue.choose("gantry", rng, "sign_gantry"), mesh, s, float(legs[1][1]), np.pi / 2, solid=False)
    for leg in legs:
        site.block_out(*leg)


def _leg(site: Site, side: int) -> float:
    half, _, curb = site.street.ground.section[side, :3]
    return float(half + curb + 0.8) * (1.0 if side == 0 else -1.0)
