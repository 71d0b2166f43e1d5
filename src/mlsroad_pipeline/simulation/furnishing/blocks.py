"""Blocks of a street with all static and moving objects, each drawn from its own seed, ready for ray casting."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.furnishing import corners, curbside, hard_cases, overhead, parking, premises, years
from mlsroad_pipeline.simulation.furnishing.placement import Box, Placed, Site, box_around
from mlsroad_pipeline.simulation.furnishing.traffic import draw_traffic
from mlsroad_pipeline.simulation.objects.dimensions import Measures, measure
from mlsroad_pipeline.simulation.rays.moving import Mover
from mlsroad_pipeline.simulation.rays.scene import TriangleSoup, triangle_soup
from mlsroad_pipeline.simulation.street.drive import Drive
from mlsroad_pipeline.simulation.street.ground_mesh import ground_mesh
from mlsroad_pipeline.simulation.street.street import BLOCK, Street

PASS_INSTANCES = 10_000_000  # Offset of the instance numbers of moving objects per further pass


class ObjectRecord(NamedTuple):
    """Truth about one object."""

    # instance, label: instance number and taxonomy code of the whole
    instance: int
    label: int
    design: str  # Name of its design
    base: NDArray[np.float64]  # Base point, street-local metres; of a moving object when the van passes it
    moving: bool  # Whether it moves
    box: Box  # Its box
    hard_case: str  # Kind of confusable neighbour, if it was placed as such
    measures: Measures  # Lean and plates of poles and signs; the panel's middle is street-local


@dataclass(frozen=True)
class Block:
    """Block with its objects."""

    soup: TriangleSoup  # Static geometry
    movers: list[Mover]  # Moving objects that the van meets in it
    records: list[ObjectRecord]  # Truth about both


def populate(street: Street, block: int) -> list[Placed]:
    """Return all static objects of a block, numbered from ``-MARGIN``; the result is deterministic."""
    site = Site(street, block)
    corners.keep_clear(site)
    premises.build(site)
    corners.furnish(site)
    overhead.utility_line(site)
    overhead.over_the_road(site)
    curbside.lamps(site)
    curbside.bus_stops(site)
    parking.park(site)
    premises.park_on_drives(site)
    curbside.tree_rows(site)
    curbside.furnish(site)
    curbside.plant_median(site)
    corners.furnish_side_streets(site)
    premises.plant_gardens(site)
    premises.grow(site)
    hard_cases.add(site)
    parking.park_two_wheelers(site)
    years.change(site)
    return site.placed


def block_centre(street: Street, number: int) -> tuple[NDArray[np.float64], float]:
    """Return the middle of a block in whole metres, street-local, and the heading of the street there."""
    middle, heading = street.on_ground((number + 0.5) * BLOCK, 0.0)
    return np.round(middle), heading


def build_block(street: Street, drive: Drive, number: int, *, pass_number: int = 0) -> Block:
    """Build a block and its objects, always the same; each pass has its own traffic, timed to meet the `drive`."""
    placed = populate(street, number)
    centre, heading = block_centre(street, number)
    meshes = [ground_mesh(street, number), *(p.mesh for p in placed)]
    soup = triangle_soup(meshes, [0, *(p.instance for p in placed)], centre, heading=heading)
    other = replace(street, seed=street.seed + 1_000_003 * pass_number)
    movers = [
        replace(m, instance=m.instance + PASS_INSTANCES * pass_number) for m in draw_traffic(other, drive, number)
    ]
    records = [
        ObjectRecord(p.instance, p.label, p.design, p.base, False, p.box, p.hard_case, measure(p.mesh, p.label, p.base))
        for p in placed
        if p.instance
    ]
    for m in movers:
        base, heading = street.on_ground(m.motion.station, m.motion.offset)
        box = box_around(m.mesh, base, heading + (np.pi if m.motion.speed < 0 else 0.0))
        records.append(ObjectRecord(m.instance, m.label, m.design, base, True, box, "", Measures()))
    return Block(soup, movers, records)
