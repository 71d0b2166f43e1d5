"""Moving objects: vehicles and cyclists in the lanes, people on the pavements, each timed to meet the van."""

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.furnishing import catalogue
from mlsroad_pipeline.simulation.furnishing.parking import cyclists, is_left_out
from mlsroad_pipeline.simulation.furnishing.placement import INSTANCES_PER_BLOCK
from mlsroad_pipeline.simulation.model.meshes import Design
from mlsroad_pipeline.simulation.objects.people import WALKERS
from mlsroad_pipeline.simulation.rays.moving import Motion, Mover
from mlsroad_pipeline.simulation.street.drive import Drive
from mlsroad_pipeline.simulation.street.street import BLOCK, MARGIN, Street, generator

_SLOT = 30.0  # length of street with at most one met vehicle per lane, metres
_VEHICLES = ("car", "van", "bus", "truck", "motorcycle")
_SHARES = np.array([0.66, 0.14, 0.1, 0.06, 0.04])
_MOTORCYCLES = ("ridden_motorcycle", "ridden_scooter")


class _Meetings:
    """Moving objects of one block."""

    def __init__(self, street: Street, drive: Drive, block: int) -> None:
        self.street, self.drive, self.block = street, drive, block
        self.rng = generator(street.seed, 30, block)
        self.movers: list[Mover] = []
        shares = _SHARES * np.where(np.array(_VEHICLES) == "truck", street.parameters.lorries, 1.0)
        self.shares = shares / shares.sum()

    def add(
        self, design: Design, station: float, speed: float, offset: float, rng: np.random.Generator | None = None
    ) -> None:
        """Add an object that passes a station at the same time as the van."""
        first = (self.block + MARGIN) * INSTANCES_PER_BLOCK + INSTANCES_PER_BLOCK // 2
        motion = Motion(station, self.drive.time_at(station), speed, offset)
        mesh = design.build(rng or self.rng)
        self.movers.append(Mover(TAXONOMY[design.label], first + len(self.movers), mesh, motion, design.name))

    def vehicle(self) -> Design:
        """Draw a vehicle; motorcycles with their riders."""
        label = _VEHICLES[int(self.rng.choice(len(_VEHICLES), p=self.shares))]
        if label == "motorcycle" and is_left_out(self.rng, self.street.parameters.two_wheelers):
            label = "car"
        if label == "motorcycle":
            return catalogue.choose("rider", self.rng, _MOTORCYCLES[int(self.rng.integers(2))])
        return catalogue.choose(label, self.rng)

    def walker(self) -> Design:
        """Draw a design of a walking person."""
        known = [catalogue.choose("person", self.rng, name) for name in WALKERS]
        weights = np.array([design.weight for design in known])
        return known[int(self.rng.choice(len(known), p=weights / weights.sum()))]


def draw_traffic(street: Street, drive: Drive, block: int) -> list[Mover]:
    """Return oncoming vehicles, cyclists, vehicles in the other lanes, and pedestrians that the van meets in a block.

    Vehicles of one lane have one speed, so that none collides with another.
    """
    meet = _Meetings(street, drive, block)
    rng, parameters, ground = meet.rng, street.parameters, street.ground
    pace = generator(street.seed, 31)
    lanes = int(ground.shape[4])
    oncoming, overtaking = pace.uniform(7, 13, 3), pace.uniform(6, 14, 3)
    riding, walking = float(pace.uniform(3.5, 6.0)), pace.uniform(0.9, 1.7, (2, 2))
    for slot in range(2):
        middle = block * BLOCK + (slot + 0.5) * _SLOT
        if rng.random() < 0.55 * parameters.traffic:
            lane = int(rng.integers(lanes))
            station = middle + float(rng.uniform(-6, 6))
            meet.add(meet.vehicle(), station, -float(oncoming[lane]), ground.lane_centre(lane))
    if lanes > 1 and block % 3 == 0 and rng.random() < 0.8 * parameters.traffic:
        # A vehicle at the van's own speed would stay beside it; the van meets few, far apart.
        lane = int(rng.integers(lanes - 1))
        meet.add(meet.vehicle(), (block + 0.5) * BLOCK, float(overtaking[lane]), -ground.lane_centre(lane))
    # Between the outermost lane and the curb or the parked cars on the other side of the street.
    edge, ridden = float(ground.section[0, 0] - ground.section[0, 1] - 0.4), list[float]()
    bicycle = catalogue.choose("rider", rng, "ridden_bicycle")
    if rng.random() < 0.45 * parameters.traffic * min(parameters.two_wheelers, 1.0):
        ridden.append(float(rng.uniform(0.1, 0.9) + block) * BLOCK)
        meet.add(bicycle, ridden[0], -riding, edge)
    for side, way in ((0, 1), (1, -1)):
        half, _, curb, verge, pavement = (float(v) for v in ground.section[side])
        for _ in range(int(rng.poisson(0.8 * parameters.people))):
            direction = int(rng.integers(2))
            offset = way * (half + curb + verge + (0.35 + 0.3 * direction) * pavement)
            station = float(rng.uniform(block * BLOCK, (block + 1) * BLOCK))
            speed = float(walking[side, direction]) * (1 if direction else -1)
            meet.add(meet.walker(), station, speed, offset)
    own, stations = cyclists(street, block, ridden)
    for station in stations:
        meet.add(bicycle, station, -riding, edge, own)
    return meet.movers
