"""What moves: cars, vans, buses and cyclists in the lanes, people on the pavements, each timed to meet the van."""

from __future__ import annotations

from mlsroad_pipeline.algorithms.classes import TAXONOMY
from mlsroad_pipeline.algorithms.simulation import vehicles
from mlsroad_pipeline.algorithms.simulation.drive import Drive
from mlsroad_pipeline.algorithms.simulation.layout import INSTANCES_PER_BLOCK
from mlsroad_pipeline.algorithms.simulation.meshes import Mesh
from mlsroad_pipeline.algorithms.simulation.scene import Motion, Mover
from mlsroad_pipeline.algorithms.simulation.street import BLOCK, MARGIN, Street, generator


def draw_traffic(street: Street, drive: Drive, block: int) -> list[Mover]:
    """Return what the van meets while it is in a block.

    Parameters
    ----------
    street : Street
        The street.
    drive : Drive
        The van's drive; traffic keeps clear of it.
    block : int
        Number of the block.

    Returns
    -------
    list of Mover
        Oncoming vehicles, a cyclist or a vehicle in the other lane, people who walk.
    """
    rng = generator(street.seed, 30, block)
    first = (block + MARGIN) * INSTANCES_PER_BLOCK + INSTANCES_PER_BLOCK // 2
    lane, lanes = street.ground.shape[3:]
    left, right = street.ground.section
    movers: list[Mover] = []

    def add(label: str, mesh: Mesh, speed: float, offset: float) -> None:
        station = float(rng.uniform(block * BLOCK, (block + 1) * BLOCK))
        motion = Motion(station, drive.time_at(station), speed, offset)
        movers.append(Mover(TAXONOMY[label], first + len(movers), mesh, motion))

    oncoming = float((rng.integers(int(lanes)) + 0.5) * lane)
    drawn = float(rng.random())
    if drawn < 0.6:
        add("car", vehicles.car(rng), -float(rng.uniform(7, 13)), oncoming)
    elif drawn < 0.8:
        add("van", vehicles.van(rng), -float(rng.uniform(7, 12)), oncoming)
    else:
        add("bus", vehicles.bus(rng), -float(rng.uniform(5, 9)), oncoming)
    if lanes > 1 and rng.random() < 0.5:
        add("car", vehicles.car(rng), float(rng.uniform(6, 14)), -0.5 * lane)
    elif rng.random() < 0.6:
        # Between the van's lane and the curb or the parked cars on the other side of the street.
        add("bicycle", vehicles.cyclist(rng), -float(rng.uniform(3.5, 6.5)), float(left[0] - left[1] - 0.45))
    for side, section in ((1, left), (-1, right)):
        for _ in range(int(rng.poisson(0.8))):
            offset = side * float(section[0] + section[2] + section[3] + 0.5 * section[4] + rng.uniform(-0.3, 0.3))
            speed = float(rng.uniform(0.9, 1.7) * rng.choice([-1, 1]))
            add("person", vehicles.person(rng), speed, offset)
    return movers
