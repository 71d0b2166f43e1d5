"""Blocks of a street with all static and moving objects, ready for ray casting."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.furnishing.layout import populate
from mlsroad_pipeline.simulation.furnishing.placement import Box, Placed, box_around
from mlsroad_pipeline.simulation.furnishing.traffic import draw_traffic
from mlsroad_pipeline.simulation.objects.dimensions import Measures, measure
from mlsroad_pipeline.simulation.rays.moving import Mover
from mlsroad_pipeline.simulation.rays.static import TriangleSoup, triangle_soup
from mlsroad_pipeline.simulation.street.drive import Drive
from mlsroad_pipeline.simulation.street.ground_mesh import ground_mesh
from mlsroad_pipeline.simulation.street.street import BLOCK, Street

PASS_INSTANCES = 10_000_000
"""Offset of the instance numbers of moving objects per further pass."""


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


def block_centre(street: Street, number: int) -> tuple[NDArray[np.float64], float]:
    """Return the middle of a block in whole metres, street-local, and the heading of the street there."""
    xy, heading = street.alignment.place([(number + 0.5) * BLOCK], [0.0])
    z = street.ground.height([(number + 0.5) * BLOCK], [0.0])
    return np.round(np.array([xy[0, 0], xy[0, 1], z[0]])), float(heading[0])


def build_block(street: Street, drive: Drive, number: int, *, pass_number: int = 0) -> Block:
    """Build a block and its objects; the result is deterministic.

    Traffic is timed to meet the `drive`; each pass has its own.
    """
    placed = populate(street, number)
    centre, heading = block_centre(street, number)
    meshes = [ground_mesh(street, number), *(p.mesh for p in placed)]
    soup = triangle_soup(meshes, [0, *(p.instance for p in placed)], centre, heading=heading)
    other = replace(street, seed=street.seed + 1_000_003 * pass_number)
    movers = [
        replace(m, instance=m.instance + PASS_INSTANCES * pass_number) for m in draw_traffic(other, drive, number)
    ]
    records = [_standing_record(p) for p in placed if p.instance]
    return Block(soup, movers, records + [_moving_record(street, m) for m in movers])


def _standing_record(placed: Placed) -> ObjectRecord:
    return ObjectRecord(
        placed.instance, placed.label, placed.design, placed.base, False, placed.box, placed.hard_case,
        measure(placed.mesh, placed.label, placed.base),
    )  # fmt: skip


def _moving_record(street: Street, mover: Mover) -> ObjectRecord:
    motion = mover.motion
    xy, heading = street.alignment.place([motion.station], [motion.offset])
    z = street.ground.height([motion.station], [motion.offset])
    base = np.array([xy[0, 0], xy[0, 1], z[0]])
    turn = float(heading[0]) + (np.pi if motion.speed < 0 else 0.0)
    box = box_around(mover.mesh, base, turn)
    return ObjectRecord(mover.instance, mover.label, mover.design, base, True, box, "", Measures())
