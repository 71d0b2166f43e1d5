"""Designs of built things and vehicles: every one over several streams, then what makes each family what it is."""

import gzip
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from references_simulator import enclosed_volume

from mlsroad_pipeline.algorithms.classes import TAXONOMY
from mlsroad_pipeline.algorithms.exceptions import ParameterError
from mlsroad_pipeline.algorithms.simulation.meshes import GLASS, KIND, LABEL, RED, REFLECTIVITY, RETRO, Surface
from mlsroad_pipeline.algorithms.simulation.objects import (
    bus_stops,
    cars,
    gantries,
    light_poles,
    street_furniture,
    traffic_lights,
    traffic_signs,
    utility_poles,
    vans_trucks,
)
from mlsroad_pipeline.algorithms.simulation.objects.bodywork import Body, skin
from mlsroad_pipeline.algorithms.simulation.objects.dimensions import sign_plates, tilt
from mlsroad_pipeline.algorithms.simulation.objects.sign_plates import SHAPES, sign_plate

MODULES = (
    light_poles, utility_poles, traffic_signs, gantries, traffic_lights, bus_stops, street_furniture, cars, vans_trucks,
)  # fmt: skip
DESIGNS = {design.name: design for module in MODULES for design in module.DESIGNS}
POLES = [d.name for m in (light_poles, utility_poles, traffic_signs, traffic_lights) for d in m.DESIGNS]
VEHICLES = [d.name for m in (cars, vans_trucks) for d in m.DESIGNS]
STREAMS = range(4)

# Height above the ground (m), and the largest extent in the plan (m), of every design.
SIZES = {
    "single_arm_lamp": (5.4, 12.6, 4.2), "double_arm_lamp": (5.9, 13.1, 7.6), "curved_arm_lamp": (5.4, 11.3, 4.2),
    "heritage_lantern": (3.0, 5.6, 2.0), "banner_lamp": (5.4, 11.6, 3.8), "lamp_with_sign": (5.4, 12.1, 4.2),
    "post_top_lamp": (3.1, 6.1, 1.0), "high_mast": (13.9, 24.3, 3.4),
    "wood_pole": (7.7, 12.2, 2.8), "double_cross_arm_pole": (7.7, 12.2, 2.8), "concrete_line_pole": (7.7, 12.2, 2.8),
    "bracket_pole": (7.7, 11.6, 2.6), "rack_pole": (7.7, 11.6, 3.6), "transformer_pole": (7.7, 12.2, 2.8),
    "utility_pole_with_lamp": (7.7, 12.2, 4.6),
    "round_sign": (1.2, 3.7, 1.1), "triangular_sign": (1.2, 3.7, 1.2), "yield_sign": (1.2, 3.7, 1.2),
    "rectangular_sign": (0.9, 3.8, 1.2), "square_sign": (1.1, 3.6, 1.0), "octagonal_sign": (1.2, 3.7, 1.1),
    "diamond_sign": (1.2, 4.0, 1.4), "arrow_sign": (0.85, 3.2, 1.6), "several_plates_sign": (2.4, 6.0, 1.7),
    "two_post_sign": (1.6, 4.0, 3.2), "street_name_sign": (2.2, 3.2, 2.3), "chevron_board": (0.7, 2.3, 0.8),
    "sign_gantry": (6.0, 9.3, 23.5), "cantilever_gantry": (6.3, 9.0, 8.3),
    "post_signal": (2.7, 5.1, 1.9), "mast_arm_signal": (5.5, 8.4, 9.6), "pedestrian_signal": (2.5, 3.5, 1.2),
    "station_flag": (2.4, 3.3, 1.1), "station_totem": (2.1, 3.5, 0.9), "glass_shelter": (2.2, 3.1, 5.9),
    "solid_shelter": (2.0, 3.3, 5.3), "canopy_shelter": (2.3, 3.4, 5.1),
    "wheelie_bin": (0.85, 2.0, 1.6), "large_container": (0.9, 1.8, 1.7), "litter_bin": (0.6, 1.5, 0.9),
    "post_bin": (0.8, 1.5, 0.7), "bottle_bank": (1.3, 2.0, 2.0), "slatted_bench": (0.4, 1.1, 2.4),
    "block_bench": (0.35, 0.55, 2.5), "metal_seats": (0.7, 1.0, 2.6), "bollard": (0.5, 1.4, 0.5),
    "flexible_post": (0.65, 1.2, 0.4), "hydrant": (0.5, 0.95, 0.7), "pillar_hydrant": (0.8, 1.3, 0.5),
    "mail_box": (0.6, 1.85, 0.7), "pillar_box": (1.1, 1.75, 0.8), "parking_meter": (1.1, 1.6, 0.5),
    "pay_station": (1.3, 2.5, 0.6), "cycle_rack": (0.65, 1.0, 4.5), "planter": (0.35, 1.7, 2.2),
    "cabinet": (0.7, 1.7, 1.75), "advertising_column": (2.5, 4.3, 1.8), "poster_case": (1.8, 2.9, 1.5),
    "traffic_cone": (0.4, 1.0, 0.5),
}  # fmt: skip

# Length, width without mirrors but with turned wheels, and height (m) of vehicles, from the least to the largest.
VEHICLE_SIZES = {
    "sedan": ((4.25, 5.1), (1.7, 2.0), (1.36, 1.85)), "hatchback": ((3.55, 4.5), (1.6, 1.9), (1.4, 2.15)),
    "estate": ((4.35, 5.05), (1.7, 1.98), (1.4, 2.12)), "suv": ((4.15, 5.05), (1.76, 2.1), (1.56, 2.42)),
    "minivan": ((4.15, 5.05), (1.72, 2.04), (1.54, 2.36)), "convertible": ((3.75, 4.7), (1.64, 1.94), (1.2, 1.75)),
    "panel_van": ((4.0, 6.9), (1.68, 2.1), (1.7, 3.1)), "minibus": ((4.0, 6.9), (1.68, 2.1), (1.7, 3.1)),
    "pickup": ((4.85, 5.9), (1.74, 2.1), (1.68, 2.2)), "box_truck": ((5.7, 9.7), (2.0, 2.65), (2.6, 4.3)),
    "flatbed_truck": ((5.7, 9.7), (2.0, 2.6), (2.1, 3.4)), "tipper_truck": ((5.7, 9.7), (2.0, 2.7), (2.1, 3.4)),
    "articulated_lorry": ((13.9, 16.9), (2.4, 3.6), (2.9, 4.2)), "bus": ((8.4, 13.1), (2.4, 2.6), (2.85, 3.6)),
    "articulated_bus": ((16.9, 19.2), (2.4, 5.0), (2.85, 3.6)),
}  # fmt: skip

ALSO = {  # classes that faces have beside the whole's
    "lamp_with_sign": {"traffic_sign"}, "post_signal": {"traffic_sign"}, "mast_arm_signal": {"traffic_sign"},
    "sign_gantry": {"traffic_sign"}, "cantilever_gantry": {"traffic_sign"}, "planter": {"other_vegetation"},
    "wood_pole": {"traffic_sign"}, "double_cross_arm_pole": {"traffic_sign"}, "concrete_line_pole": {"traffic_sign"},
    "transformer_pole": {"traffic_sign", "transformer"}, "utility_pole_with_lamp": {"traffic_sign", "light_pole"},
    "rack_pole": {"light_pole"}, "bracket_pole": {"transformer"},
}  # fmt: skip


@cache
def built(name, stream):
    return DESIGNS[name].build(np.random.default_rng([11, stream]))


def areas(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    sides = [np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (c, a))]
    half = sum(sides) / 2
    return np.sqrt(np.maximum(half * np.prod([half - s for s in sides], axis=0), 0))  # Heron


def used(mesh):
    return mesh.vertices[np.unique(mesh.faces)]


def budget(name):
    if name == "articulated_bus":  # two cars with all their seats
        return 3800
    return 2500 if name in VEHICLES else 1000


def test_names_are_unique_and_every_design_has_its_sizes():
    assert len(DESIGNS) == sum(len(module.DESIGNS) for module in MODULES)
    assert set(DESIGNS) == set(SIZES) | set(VEHICLE_SIZES)


def test_every_design_is_documented():
    page = (Path(__file__).resolve().parents[4] / "docs" / "street_objects.md").read_text()
    rows = {line.split("`")[1]: line.split("|")[2].strip() for line in page.splitlines() if line.startswith("| `")}
    assert rows == {name: design.label for name, design in DESIGNS.items()}


@pytest.mark.parametrize("name", DESIGNS)
def test_faces_are_sound(name):
    for stream in STREAMS:
        mesh = built(name, stream)
        assert np.isfinite(mesh.vertices).all() and np.isfinite(mesh.attributes).all()
        assert mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices)
        assert len(mesh.attributes) == len(mesh.faces) <= budget(name)
        assert areas(mesh).min() > 1e-10
        assert (mesh.attributes[:, RED:] > 0).all() and (mesh.attributes[:, RED:] <= 1).all()


@pytest.mark.parametrize("name", DESIGNS)
def test_labels_belong_to_the_design(name):
    allowed = {TAXONOMY[c] for c in {DESIGNS[name].label} | ALSO.get(name, set())}
    for stream in STREAMS:
        labels = np.unique(built(name, stream).attributes[:, LABEL].astype(int))
        assert set(labels) <= allowed
        assert TAXONOMY[DESIGNS[name].label] in labels


@pytest.mark.parametrize("name", DESIGNS)
def test_the_same_stream_gives_the_same_and_another_something_else(name):
    again = DESIGNS[name].build(np.random.default_rng([11, 0]))
    assert again.vertices.tobytes() == built(name, 0).vertices.tobytes()
    assert again.faces.tobytes() == built(name, 0).faces.tobytes()
    assert again.attributes.tobytes() == built(name, 0).attributes.tobytes()
    other = built(name, 1)
    extents = [np.ptp(used(mesh), axis=0) for mesh in (again, other)]
    assert np.abs(extents[0] - extents[1]).max() > 1e-3  # no two of one size
    assert not np.array_equal(
        np.unique(again.attributes[:, REFLECTIVITY]), np.unique(other.attributes[:, REFLECTIVITY])
    )


@pytest.mark.parametrize("name", DESIGNS)
def test_stands_at_the_origin_and_keeps_to_its_clearance(name):
    for stream in STREAMS:
        mesh = built(name, stream)
        points = used(mesh)
        assert -0.45 <= points[:, 2].min() <= 0.02
        triangles = mesh.vertices[mesh.faces]
        low = triangles[triangles[:, :, 2].min(axis=1) < 0.5].reshape(-1, 3)
        low = low[low[:, 2] < 0.5]
        if name == "sign_gantry":  # its other leg stands across the road
            assert np.abs(low[low[:, 0] < 5, :2]).max() < 0.8
            assert low[:, 0].max() > 10 and np.abs(low[:, 1]).max() <= DESIGNS[name].clearance
        else:
            assert np.abs(low[:, :2]).max() <= DESIGNS[name].clearance
            reach = low[:, :2].max(axis=0) + low[:, :2].min(axis=0)  # twice the middle of the foot
            # The articulated ones are bent; shelters stand on the posts of their backs, which are not under the middle.
            loose = {"bus_shelter": 0.9, "bus": 0.5, "truck": 0.5}.get(DESIGNS[name].label, 0.2)
            assert np.abs(reach).max() / 2 < loose


@pytest.mark.parametrize("name", SIZES)
def test_things_have_the_stated_sizes(name):
    low, high, wide = SIZES[name]
    for stream in STREAMS:
        points = used(built(name, stream))
        assert low <= points[:, 2].max() <= high
        assert np.ptp(points[:, :2], axis=0).max() <= wide


@pytest.mark.parametrize("name", VEHICLES)
def test_vehicles_have_the_stated_sizes(name):
    (short, long), (narrow, wide), (low, high) = VEHICLE_SIZES[name]
    for stream in STREAMS:
        points = used(built(name, stream))
        assert abs(points[:, 2].min()) < 0.01  # wheels on the road
        assert short <= np.ptp(points[:, 0]) <= long
        assert low <= points[:, 2].max() <= high
        body = points[(points[:, 2] > 0.3) & (points[:, 2] < 0.62)]  # below the mirrors
        assert narrow <= np.ptp(body[:, 1]) <= wide


@pytest.mark.parametrize("name", VEHICLES)
def test_vehicles_head_along_x_with_plates_and_panes(name):
    for stream in STREAMS:
        mesh = built(name, stream)
        middle = mesh.vertices[mesh.faces].mean(axis=1)
        rgb, kind = mesh.attributes[:, RED : RED + 3], mesh.attributes[:, KIND]
        half = np.ptp(used(mesh)[:, 0]) / 2
        tail = (kind == RETRO) & (rgb[:, 0] > 2.2 * rgb[:, 1]) & (rgb[:, 0] > 2.2 * rgb[:, 2])
        assert tail.sum() >= 24 and (middle[tail, 0] < -0.9 * half + 0.2).all()
        assert ((kind == RETRO) & ~tail & (middle[:, 0] < -0.85 * half)).sum() >= 12  # the licence plate
        glass = kind == GLASS
        # A windscreen looks ahead, and it slopes: its area has a component along x.
        a, b, c = (mesh.vertices[mesh.faces[glass][:, k]] for k in range(3))
        across = np.abs(np.cross(b - a, c - a)[:, 0]) / 2
        assert across[middle[glass, 0] > 0].sum() > 0.35


@pytest.mark.parametrize("name", ["sedan", "hatchback", "estate", "suv", "minivan", "panel_van", "pickup", "bus"])
def test_a_beam_passes_the_panes_and_meets_what_is_inside(name):
    mesh = built(name, 2)
    points = used(mesh)
    half = 0.45 * np.ptp(points[(points[:, 2] > 0.3) & (points[:, 2] < 0.62)][:, 1])
    panes = mesh.vertices[mesh.faces[mesh.attributes[:, KIND] == GLASS]].reshape(-1, 3)
    beside = panes[np.abs(panes[:, 1]) > 0.8 * half]
    rng = np.random.default_rng(5)
    passed = inside = 0
    for _ in range(150):
        at = rng.uniform(beside.min(axis=0), beside.max(axis=0))
        origin, target = np.array([at[0], 8.0, 2.0]), np.array([at[0], 0.9 * half, at[2]])
        t, face = _along(mesh, origin, target - origin)
        glass = mesh.attributes[face, KIND] == GLASS
        if len(t) == 0 or not glass[0]:
            continue
        passed += 1
        solid = np.flatnonzero(~glass)
        inside += len(solid) > 0 and abs(origin[1] + t[solid[0]] * (target - origin)[1]) < half
    assert passed >= 30
    assert inside >= 4


def _along(mesh, origin, direction):
    """Where a ray meets a mesh, nearest first, and which faces (Moeller and Trumbore, face by face)."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    e1, e2 = b - a, c - a
    p = np.cross(direction, e2)
    det = np.einsum("ij,ij->i", e1, p)
    det = np.where(np.abs(det) < 1e-12, np.nan, det)
    s = origin - a
    u = np.einsum("ij,ij->i", s, p) / det
    q = np.cross(s, e1)
    v = q @ direction / det
    t = np.einsum("ij,ij->i", e2, q) / det
    hit = np.flatnonzero((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0))
    order = np.argsort(t[hit])
    return t[hit][order], hit[order]


PLAIN = Body(
    0.9, 0.2, top=[(-2, 1.4), (2, 1.4)], belt=[(-2, 0.9), (2, 0.9)], shoulder=[(-2, 0.955), (2, 0.955)], axles=(),
    radius=0.3, drawn_in=0.0,
)  # fmt: skip
SKINS = [Surface(50, (0.5, 0.5, 0.5), r) for r in (0.3, 0.4, 0.5, 0.6)]


def test_skin_encloses_its_cross_section():
    mesh = skin(PLAIN, *SKINS[:3])
    # Area of the polygon from its corners: twice the half that lies at y > 0, by the trapezoid rule over z.
    z = np.array([0.2, 0.2 + 0.4 * 0.7, 0.9 - 0.22 * 0.7, 0.9, 1.34, 1.4])
    y = 0.9 * np.array([0.94, 1.0, 0.985, 0.955, 0.955, 0.55 * 0.955])
    expected = 2 * np.sum((y[1:] + y[:-1]) / 2 * np.diff(z)) * 4.0
    t, _ = _along(mesh, np.array([0.3, 5.0, 0.6]), np.array([0.0, -1.0, 0.0]))
    assert len(t) == 2  # closed: in and out
    assert abs(enclosed_volume(mesh.vertices, mesh.faces)) == pytest.approx(expected, rel=1e-9)


def test_wheels_stand_in_arches():
    body = replace(PLAIN, axles=(-1.2, 1.3), radius=0.32)
    mesh, sideways = skin(body, *SKINS[:3]), np.array([0.0, -1.0, 0.0])
    for x in body.axles:
        for z, hits in ((0.32, 0), (0.32 + 1.1 * 0.32, 0), (0.32 + 1.18 * 0.32, 2)):
            assert len(_along(mesh, np.array([x + 0.001, 5.0, z]), sideways)[0]) == hits
    assert len(_along(mesh, np.array([0.05, 5.0, 0.32]), sideways)[0]) == 2


def test_panes_and_openings_are_where_they_are_wanted():
    body = replace(PLAIN, side_panes=[(-0.5, 0.5)], top_panes=[(0.8, 1.2)], open=[(-1.5, -1.0)])
    mesh = skin(body, *SKINS[:3], roof=SKINS[3])
    down, sideways = np.array([0.0, 0.0, -1.0]), np.array([0.0, -1.0, 0.0])

    def met(origin, direction):
        return [round(float(r), 1) for r in mesh.attributes[_along(mesh, np.array(origin), direction)[1], REFLECTIVITY]]

    assert met([0.01, 5.0, 1.1], sideways) == [0.4, 0.4]  # through both side windows
    assert met([0.7, 5.0, 1.1], sideways) == [0.3, 0.3]
    assert met([1.0, 0.1, 5.0], down) == [0.4, 0.5]  # windscreen, then underside
    assert met([-1.25, 0.1, 5.0], down) == [0.5]  # nothing above
    assert met([-0.2, 0.1, 5.0], down) == [0.3, 0.5]
    assert met([1.1, 0.1, 5.0], down)[0] == 0.4


@pytest.mark.parametrize("name", [d.name for d in utility_poles.DESIGNS])
def test_wires_hang_from_the_pole(name):
    o3d = pytest.importorskip("open3d")
    for stream in STREAMS:
        pole, points = utility_poles.hung_pole(name, np.random.default_rng([11, stream]))
        assert pole.vertices.tobytes() == built(name, stream).vertices.tobytes()
        assert points.shape == (utility_poles.WIRES, 3)
        again = utility_poles.attachment_points(name, np.random.default_rng([11, stream]))
        assert again.tobytes() == points.tobytes()
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(pole.vertices.astype(np.float32), pole.faces.astype(np.uint32))
        assert scene.compute_distance(points.astype(np.float32)).numpy().max() < 0.003
        assert points[:, 2].min() > 4.0  # clear of what drives below
        assert points[:4, 2].min() > points[4:, 2].max()  # conductors above cables
        assert (np.diff(points[:4, 0]) > -0.05).all()  # so that wires do not cross
        gaps = np.linalg.norm(points[:, None] - points[None], axis=2)[np.triu_indices(utility_poles.WIRES, 1)]
        assert gaps.min() > 0.18


def test_unknown_poles_and_shapes_are_named():
    with pytest.raises(ParameterError, match="'oak'"):
        utility_poles.hung_pole("oak", np.random.default_rng(0))
    with pytest.raises(ParameterError, match="'star'"):
        sign_plate(np.random.default_rng(0), "star")


@pytest.mark.parametrize("name", POLES)
def test_tilt_is_that_of_the_mast_and_within_three_degrees(name):
    angles = np.array([tilt(built(name, stream)) for stream in STREAMS])
    assert angles.max() <= 3.0


def test_a_share_of_masts_leans():
    build = DESIGNS["single_arm_lamp"].build
    meshes = [build(np.random.default_rng([12, k])) for k in range(80)]
    angles = np.array([tilt(mesh) for mesh in meshes])
    assert 0.12 < (angles > 0.6).mean() < 0.42
    for mesh, angle in zip(meshes[:10], angles[:10], strict=True):
        # The same from the mast alone: middles of its sections 0.5 m and 5 m above the ground.
        low, high = (_section_middle(mesh, z) for z in (-0.2, 0.3))
        assert np.degrees(np.arctan2(np.hypot(*(high - low)), 0.5)) == pytest.approx(angle, abs=0.4)


def _section_middle(mesh, z):
    triangles = mesh.vertices[mesh.faces]
    points = []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        p, q = triangles[:, a], triangles[:, b]
        f = (z - p[:, 2]) / np.where(q[:, 2] == p[:, 2], np.nan, q[:, 2] - p[:, 2])
        hit = (f >= 0) & (f <= 1)
        points.append((p + f[:, None] * (q - p))[hit, :2])
    points = np.concatenate(points)
    return (points.max(axis=0) + points.min(axis=0)) / 2


def test_tilt_needs_a_foot():
    with pytest.raises(ParameterError, match="foot"):
        tilt(built("sedan", 0))


@pytest.mark.parametrize("shape", SHAPES)
def test_plates_of_signs_look_along_x_and_have_their_sizes(shape):
    for stream in STREAMS:
        mesh, half = sign_plate(np.random.default_rng([13, stream]), shape)
        plates = sign_plates(mesh)
        assert len(plates.yaw) == 1  # border, field and marks are one plate
        assert abs(plates.yaw[0]) < 1e-6
        points = used(mesh)
        assert plates.height[0] == pytest.approx(np.ptp(points[:, 2])) == pytest.approx(2 * half)
        assert plates.width[0] == pytest.approx(np.ptp(points[:, 1]))
        assert 0.2 <= plates.width[0] <= 1.4 and 0.2 <= plates.height[0] <= 1.3
        if shape in ("round", "octagon"):
            assert plates.width[0] == pytest.approx(plates.height[0], rel=0.02)
            assert 0.59 <= plates.width[0] <= 0.91


def test_outlines_are_those_of_their_shapes():
    # Area of the plate over that of its bounding box.
    shares = {
        "round": np.pi / 4,
        "triangle": 0.5,
        "yield": 0.5,
        "diamond": 0.5,
        "octagon": 2 * np.sqrt(2) - 2,
        "square": 0.99,
    }
    for shape, share in shares.items():
        mesh, half = sign_plate(np.random.default_rng(3), shape)
        largest = areas(mesh)[np.isclose(mesh.vertices[mesh.faces].mean(axis=1)[:, 0], -0.002)].sum()
        width = np.ptp(mesh.vertices[:, 1])
        assert largest / (2 * half * width) == pytest.approx(share, abs=0.02)


def test_signs_on_posts_look_along_x_at_their_heights():
    bottoms = []
    for stream in range(40):
        plates = sign_plates(DESIGNS["round_sign"].build(np.random.default_rng([14, stream])))
        assert len(plates.yaw) == 1 and abs(plates.yaw[0]) < 0.4
        bottoms.append(plates.centre[0, 2] - plates.height[0] / 2)
    bottoms = np.array(bottoms)
    assert bottoms.min() > 0.6 and bottoms.max() < 2.6
    assert 0.6 < (bottoms > 1.95).mean() < 0.95


@pytest.mark.parametrize("name", ["lamp_with_sign", "sign_gantry", "cantilever_gantry"])
def test_signs_on_other_poles_look_along_y(name):
    ahead = []
    for stream in range(12):
        plates = sign_plates(DESIGNS[name].build(np.random.default_rng([15, stream])))
        assert len(plates.yaw) >= 1
        assert np.abs(np.abs(plates.yaw) - np.pi / 2).max() < 0.45
        assert (plates.centre[:, 2] - plates.height / 2).min() > (1.9 if name == "lamp_with_sign" else 5.0)
        ahead += list(plates.yaw > 0)
    assert np.mean(ahead) > 0.6


@pytest.mark.parametrize("name", ["single_arm_lamp", "curved_arm_lamp", "mast_arm_signal", "cantilever_gantry"])
def test_arms_reach_along_x(name):
    for stream in STREAMS:
        points = used(built(name, stream))
        top = points[points[:, 2] > 0.8 * points[:, 2].max()]
        assert top[:, 0].max() > 0.4
        assert top[:, 0].max() > 1.5 * -top[:, 0].min()
        assert np.abs(top[:, 1]).max() < max(0.4 * top[:, 0].max(), 1.6)


@pytest.mark.parametrize(("name", "axis"), [("post_signal", 1), ("mast_arm_signal", 1), ("pedestrian_signal", 0)])
def test_signals_look_at_those_they_are_for(name, axis):
    # Lenses are the only faces with a saturated colour; red ones of vehicles look along +y, of walkers along +x.
    for stream in STREAMS:
        mesh = built(name, stream)
        rgb = mesh.attributes[:, RED : RED + 3]
        a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        lens = (np.abs(rgb - [0.4, 0.04, 0.03]) < 1e-6).all(axis=1)
        front = normal[lens] @ np.eye(3)[axis] / np.linalg.norm(normal[lens], axis=1)
        assert lens.sum() >= 20
        assert (front > 0.97).sum() >= 20


@pytest.mark.parametrize("name", ["glass_shelter", "heritage_lantern"])
def test_glass_is_glass(name):
    for stream in STREAMS:
        assert (built(name, stream).attributes[:, KIND] == GLASS).sum() >= 4


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("prefix", "design", "measured"),
    [
        ("SL", "single_arm_lamp", (7.4, 9.3)),
        ("PS", "pedestrian_signal", (2.99, 3.2)),
        ("STL_18", "mast_arm_signal", (6, 9.2)),
    ],
)
def test_real_poles_are_as_high_as_simulated_ones_may_be(real_data, prefix, design, measured):
    simulated = np.array([used(DESIGNS[design].build(np.random.default_rng([16, k])))[:, 2].max() for k in range(60)])
    heights = []
    for path in sorted(real_data("taiwan_poles").glob(f"{prefix}*.csv.gz")):
        with gzip.open(path, "rt") as text:
            z = np.loadtxt(text, delimiter=",", usecols=2) / 1000
        heights.append(np.ptp(z))
    typical = np.median(heights)
    assert measured[0] < typical < measured[1]
    assert simulated.min() < typical < max(simulated.max(), 9.2 if prefix == "STL_18" else 0)
