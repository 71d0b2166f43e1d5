from dataclasses import replace
from itertools import pairwise

import numpy as np
import open3d as o3d
import pytest
from references.simulator import hulls_overlap

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.furnishing import catalogue, curbside, parking, traffic
from mlsroad_pipeline.simulation.furnishing.blocks import populate
from mlsroad_pipeline.simulation.furnishing.placement import INSTANCES_PER_BLOCK, overlaps
from mlsroad_pipeline.simulation.furnishing.traffic import draw_traffic
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS
from mlsroad_pipeline.simulation.street.drive import Drive
from mlsroad_pipeline.simulation.street.street import BLOCK, MARGIN, draw_street

FIXED = {TAXONOMY[name] for name in ("building", "wall", "fence", "hedge")}
WIRE = TAXONOMY["wire"]
BARE = dict.fromkeys(("trees", "palms", "cycas", "shrubs"), 0.0)
"""Street without plants, whose meshes take most of the time."""


@pytest.fixture(scope="module")
def streets():
    """Return a street of each kind and the static objects of one of its two blocks, of the first one of both."""
    kinds = [*STREETS.values(), replace(STREETS["town"], two_wheelers=5.0)]
    drawn = [draw_street(k, length=120.0, parameters=p) for k, p in enumerate(kinds)]
    (first, *rest) = drawn
    return [
        (first, populate(first, 0) + populate(first, 1)),
        *((street, populate(street, k % 2)) for k, street in enumerate(rest)),
    ]


def test_blocks_are_drawn_alike_every_time_and_numbered_apart(streets):
    street, placed = streets[0]
    again = populate(street, 0)
    for a, b in zip(placed, again, strict=False):
        np.testing.assert_array_equal(a.mesh.vertices, b.mesh.vertices)
        assert (a.instance, a.design, a.box, a.hard_case) == (b.instance, b.design, b.box, b.hard_case)
    numbers = [p.instance for p in placed if p.instance]
    assert len(numbers) == len(set(numbers)) > 60
    first = MARGIN * INSTANCES_PER_BLOCK
    assert min(numbers) > first and max(numbers) < first + 2 * INSTANCES_PER_BLOCK
    assert {p.label for p in placed if not p.instance} <= FIXED


def test_nothing_floats(streets):
    for street, placed in streets:
        for thing in placed:
            if thing.label == WIRE or thing.design == "plate_on_lamp":
                continue
            low = thing.mesh.vertices[thing.mesh.vertices[:, 2].argmin()]
            station, offset = street.alignment.locate(low[None, :2], near=60.0)
            assert low[2] - street.ground.height(station, offset)[0] < 0.12, thing.design


def test_boxes_hold_the_meshes(streets):
    for _, placed in streets:
        for thing in placed:
            c, s = np.cos(thing.box.heading), np.sin(thing.box.heading)
            rest = thing.mesh.vertices - [thing.box.x, thing.box.y, thing.base[2]]
            along, across = rest[:, 0] * c + rest[:, 1] * s, rest[:, 1] * c - rest[:, 0] * s
            assert np.ptp(along) == pytest.approx(thing.box.length, abs=1e-6), thing.design
            assert np.ptp(across) == pytest.approx(thing.box.width, abs=1e-6), thing.design
            assert rest[:, 2].max() == pytest.approx(thing.box.height, abs=1e-6), thing.design


def test_footprints_do_not_interpenetrate_unless_planned(streets):
    checked = 0
    for _, placed in streets:
        low = []
        for thing in placed:
            if thing.instance == 0 or thing.label == WIRE or thing.design == "plate_on_lamp" or thing.hard_case:
                continue
            below = thing.mesh.vertices[:, 2] - thing.base[2] < 1.2
            low.append((thing, thing.mesh.vertices[below, :2]))
        for k, (one, points) in enumerate(low):
            for other, theirs in low[k + 1 :]:
                if np.hypot(*(one.base - other.base)[:2]) < 8:
                    checked += 1
                    assert not hulls_overlap(points, theirs), (one.design, other.design)
    assert checked > 50 * len(streets)


def test_static_objects_are_off_the_carriageway(streets):
    drive_there = {TAXONOMY[name] for name in ("car", "van", "truck", "bus")} | {WIRE}
    for street, placed in streets:
        bases = np.array([p.base for p in placed if p.label not in drive_there and p.instance])
        station, offset = street.alignment.locate(bases[:, :2], near=60.0)
        assert street.ground.edge(station, offset)[0].min() > 0


def test_the_number_of_hard_cases_follows_the_parameter():
    found = []
    for share in (0.0, 0.3, 1.0):
        street = draw_street(2, length=120.0, parameters=replace(STREETS["town"], hard_cases=share, **BARE))
        placed = populate(street, 0) + populate(street, 1)
        cases = [p for p in placed if p.hard_case]
        found.append(len(cases))
        for case in cases:
            others = [p for p in placed if p is not case and p.label != WIRE and p.instance]
            assert min(np.hypot(*(case.base - other.base)[:2]) for other in others) < 4.0
    assert found[0] == 0 < found[1] < found[2]
    assert found[2] > 20


def test_lamps_keep_their_spacing():
    parameters = replace(STREETS["town"], lamp_spacing=30.0, hard_cases=0.0, junction_spacing=0.0, **BARE)
    street = draw_street(5, length=240.0, parameters=parameters)
    placed = [p for block in range(3) for p in populate(street, block)]
    lamps = np.array([p.base for p in placed if p.label == TAXONOMY["light_pole"]])
    station, _ = street.alignment.locate(lamps[:, :2], near=120.0)
    gaps = np.diff(np.sort(station))
    assert len(lamps) >= 6
    assert 15 < np.median(gaps[gaps > 8]) < 45


def test_cars_stand_within_their_bays():
    parameters = replace(STREETS["town"], parking=1.0, parked=1.0, slanted_parking=0.0, junction_spacing=0.0)
    street = draw_street(6, length=120.0, parameters=parameters)
    cars = [p for p in populate(street, 0) if p.label == TAXONOMY["car"]]
    assert len(cars) >= 6
    for car in cars:
        low = car.mesh.vertices[car.mesh.vertices[:, 2] - car.base[2] < 0.7]
        station, offset = street.alignment.locate(low[:, :2], near=30.0)
        half, bay = street.ground.section[0 if np.median(offset) > 0 else 1, :2]
        assert np.abs(offset).max() < half and np.abs(offset).min() > half - bay - 0.05
        assert np.ptp(station) < 5.8


def test_wires_hang_from_pole_to_pole_with_sag():
    street = draw_street(0, length=120.0, parameters=replace(STREETS["suburb"], **BARE))
    placed = [p for block in range(3) for p in populate(street, block)]
    wires = [p for p in placed if p.label == WIRE]
    poles = [p for p in placed if p.label == TAXONOMY["utility_pole"]]
    assert len(poles) >= 3 and len(wires) > 3 * (len(poles) - 1)
    for wire in wires:
        x = wire.mesh.vertices
        along = x[:, :2] @ [np.cos(wire.box.heading), np.sin(wire.box.heading)]
        start, end = (x[np.abs(along - at) < 0.01].mean(axis=0) for at in (along.min(), along.max()))
        share = (along - along.min()) / np.ptp(along)
        assert 0.1 < (start[2] + share * (end[2] - start[2]) - x[:, 2]).max() < 1.3
        np.testing.assert_allclose(wire.base, [*((start + end) / 2)[:2], x[:, 2].min()], atol=0.02)
        assert distance_to_mesh(start, [p.mesh for p in poles]) < 0.1


def distance_to_mesh(point, meshes):
    """Return the distance from a point to the nearest face (Open3D)."""
    scene = o3d.t.geometry.RaycastingScene()
    for mesh in meshes:
        scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    return float(scene.compute_distance(point[None].astype(np.float32))[0].item())


def test_vehicles_of_a_lane_never_collide():
    street = draw_street(1, length=600.0, parameters=replace(STREETS["ring_road"], traffic=2.0))
    lanes = {}
    for block in range(10):
        for mover in draw_traffic(street, drive_of(60), block):
            if mover.label in (TAXONOMY["car"], TAXONOMY["van"], TAXONOMY["bus"], TAXONOMY["truck"]):
                lanes.setdefault(round(mover.motion.offset, 3), []).append(mover)
    assert sum(len(v) for v in lanes.values()) > 8
    for movers in lanes.values():
        assert len({m.motion.speed for m in movers}) == 1
        at_start = sorted(
            (m.motion.station - m.motion.speed * m.motion.time, np.ptp(m.mesh.vertices[:, 0])) for m in movers
        )
        for (a, long), (b, other) in pairwise(at_start):
            assert b - a > (long + other) / 2 + 1.0


def test_the_share_of_lorries_follows_the_parameter():
    def labels(lorries):
        parameters = replace(STREETS["ring_road"], traffic=1.8, people=0.0, two_wheelers=0.0, lorries=lorries)
        street = draw_street(3, length=2400.0, parameters=parameters)
        movers = [mover for block in range(40) for mover in draw_traffic(street, drive_of(2400), block)]
        return np.array([mover.label for mover in movers])

    usual, many, none = labels(1.0), labels(10.0), labels(0.0)
    assert min(len(usual), len(many), len(none)) > 80
    lorry = TAXONOMY["truck"]
    assert 0.0 < (usual == lorry).mean() < 0.15
    assert 0.25 < (many == lorry).mean() < 0.55  # 0.6 of 1.54
    assert not (none == lorry).any()


def test_bus_stops_and_gantries_can_be_excluded_and_alternate_otherwise():
    def counts(**changes):
        bare = BARE | dict.fromkeys(("clutter", "people", "buildings", "boundaries"), 0.0)
        street = draw_street(3, length=600.0, parameters=replace(STREETS["ring_road"], **bare, **changes))
        placed = [p for block in range(10) for p in populate(street, block)]
        return [sum(p.label == TAXONOMY[name] for p in placed) for name in ("bus_shelter", "gantry")]

    shelters, gantries = counts()
    assert 3 <= shelters <= 5
    assert counts(stations=0.0, gantries=0.0) == [0, 0]
    twice = counts(stations=2.0, gantries=5.0)
    assert twice[0] > shelters + 2 and twice[1] > max(gantries, 2)


TWO_WHEELED = {"bicycle", "motorcycle"}


def drive_of(seconds):
    """Return a drive at 10 m/s."""
    time = np.arange(0, seconds + 1, 1.0)
    return Drive(time, 10.0 * time, np.zeros((len(time), 6)), np.zeros((len(time), 6)), 0.0, np.zeros((3, 2)))


def all_of(multiplier, *, blocks, traffic=1.0, seed=4, **changes):
    """Return static and moving objects of a town with a factor on two-wheelers."""
    parameters = replace(STREETS["town"], two_wheelers=multiplier, traffic=traffic, **changes)
    street = draw_street(seed, length=blocks * BLOCK, parameters=parameters)
    standing = [populate(street, block) for block in range(blocks)]
    return standing, [draw_traffic(street, drive_of(60), block) for block in range(blocks)]


def assert_same(one, other):
    np.testing.assert_array_equal(one.mesh.vertices, other.mesh.vertices)
    np.testing.assert_array_equal(one.mesh.faces, other.mesh.faces)
    np.testing.assert_array_equal(one.mesh.attributes, other.mesh.attributes)
    assert (one.label, one.instance, one.design) == (other.label, other.instance, other.design)


def test_more_two_wheelers_change_nothing_else():
    (standing, moving), (more, riding) = all_of(1.0, blocks=1), all_of(5.0, blocks=1)
    for few, many in ((standing, more), (moving, riding)):
        added = []
        for before, after in zip(few, many, strict=True):
            assert len(before) < len(after)
            for one, other in zip(before, after, strict=False):
                assert_same(one, other)
            added += after[len(before) :]
        assert {catalogue_label(thing) for thing in added} <= TWO_WHEELED | {"rider"}
    assert all(a.motion == b.motion for x, y in zip(moving, riding, strict=True) for a, b in zip(x, y, strict=False))


def catalogue_label(thing):
    """Return the class of an object's design, None for objects outside the catalogue."""
    known = {design.name: label for label, group in catalogue.designs().items() for design in group}
    return known.get(thing.design)


def test_a_multiplier_of_one_draws_no_two_wheeler_and_no_random_number(monkeypatch):
    """The street equals that of a simulator without the factor."""
    standing, moving = all_of(1.0, traffic=2.0, blocks=1)
    monkeypatch.setattr(parking, "park_two_wheelers", lambda site: None)
    monkeypatch.setattr(traffic, "cyclists", lambda street, block, taken: (None, []))
    for module in (traffic, curbside):
        monkeypatch.setattr(module, "is_left_out", lambda rng, share: False)
    plain, ridden = all_of(1.0, traffic=2.0, blocks=1)
    for a, b in ((standing, plain), (moving, ridden)):
        for one, other in zip(a, b, strict=True):
            assert len(one) == len(other)
            for x, y in zip(one, other, strict=True):
                assert_same(x, y)


def test_the_number_of_two_wheelers_follows_the_parameter():
    found = []
    for multiplier in (0.0, 1.0, 5.0):
        drawn = [all_of(multiplier, seed=seed, blocks=1, **BARE) for seed in range(4)]
        parked = sum(catalogue_label(p) in TWO_WHEELED for standing, _ in drawn for block in standing for p in block)
        ridden = sum(catalogue_label(m) == "rider" for _, moving in drawn for block in moving for m in block)
        found.append((parked, ridden))
    assert found[0] == (0, 0)
    assert 3.0 < found[2][0] / found[1][0] < 7.0 and found[2][1] > 2 * found[1][1] > 0
    rng = np.random.default_rng(0)
    assert 150 < sum(parking.is_left_out(rng, 0.8) for _ in range(1000)) < 250


def test_cyclists_keep_their_distance():
    street = draw_street(1, length=600.0, parameters=replace(STREETS["town"], two_wheelers=5.0, traffic=3.0))
    riders = [
        m for block in range(10) for m in draw_traffic(street, drive_of(60), block) if m.design == "ridden_bicycle"
    ]
    assert len(riders) > 30 and len({m.motion.speed for m in riders}) == 1
    at_start = np.sort([m.motion.station - m.motion.speed * m.motion.time for m in riders])
    assert np.diff(at_start).min() > 2.5


def test_overlaps_returns_the_first_overlapping_box():
    boxes = np.array([[0, 0, 1, 1, 0], [5, 0, 2, 0.5, np.pi / 4], [5, 5, 1, 1, 0.3]])
    assert overlaps(boxes, np.array([1.9, 0, 1, 1, 0.0]), 0.0) == 0
    assert overlaps(boxes, np.array([2.1, 0, 1, 1, 0.0]), 0.0) == -1
    assert overlaps(boxes, np.array([2.1, 0, 1, 1, 0.0]), 0.2) == 0
    # The corner of a turned box reaches out, its side does not.
    assert overlaps(boxes, np.array([6.5, 1.5, 0.3, 0.3, 0.0]), 0.0) == 1
    assert overlaps(boxes, np.array([6.5, -1.5, 0.3, 0.3, 0.0]), 0.0) == -1


def test_the_catalogue_draws_by_weight_and_by_name(rng):
    known = catalogue.designs()
    assert {"tree", "palm", "cycas", "brushwood", "light_pole", "traffic_sign", "car", "van", "bus"} <= set(known)
    names = [design.name for group in known.values() for design in group]
    assert len(names) == len(set(names))
    drawn = {catalogue.choose("light_pole", rng).name for _ in range(200)}
    assert drawn <= {design.name for design in known["light_pole"]} and len(drawn) > 3
    named = known["car"][1].name
    assert catalogue.choose("car", rng, named).name == named


def test_objects_lie_within_their_block(streets):
    for street, placed in streets:
        for thing in placed:
            if thing.instance and thing.label != WIRE:
                station, _ = street.alignment.locate(thing.base[None, :2], near=60.0)
                block = (thing.instance - 1) // INSTANCES_PER_BLOCK - MARGIN
                assert -12 < station[0] - block * BLOCK < BLOCK + 12


def test_a_block_may_have_several_gantries_and_a_bus_stop_on_either_side():
    plain = replace(STREETS["ring_road"], buildings=0.0, boundaries=0.0, junction_spacing=0.0, palms=0.0, cycas=0.0)
    street = draw_street(5, length=120.0, parameters=replace(plain, stations=4.0, gantries=20.0))
    labels = [[p.label for p in populate(street, block)] for block in (0, 1)]
    assert [each.count(TAXONOMY["bus_shelter"]) for each in labels] == [2, 2]
    assert max(each.count(TAXONOMY["gantry"]) for each in labels) > 1
