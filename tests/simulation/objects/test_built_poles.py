"""Poles, signs and signals: wires, tilt, plates and directions."""

import gzip

import numpy as np
import pytest
from helpers.objects import DESIGNS, POLES, STREAMS, areas, built, section_middle, used

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.materials import material
from mlsroad_pipeline.simulation.model.meshes import RED, join, rotation_matrix
from mlsroad_pipeline.simulation.model.solids import tube
from mlsroad_pipeline.simulation.objects import utility_poles
from mlsroad_pipeline.simulation.objects.dimensions import Measures, measure, sign_plates
from mlsroad_pipeline.simulation.objects.traffic_signs import SHAPES, sign_plate


@pytest.mark.parametrize("name", [d.name for d in utility_poles.DESIGNS])
def test_wires_hang_from_the_pole(name):
    o3d = pytest.importorskip("open3d")
    for stream in STREAMS:
        pole, points = utility_poles.hung_pole(name, np.random.default_rng([11, stream]))
        assert pole.vertices.tobytes() == built(name, stream).vertices.tobytes()
        assert points.shape == (utility_poles.WIRES, 3)
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(pole.vertices.astype(np.float32), pole.faces.astype(np.uint32))
        assert scene.compute_distance(points.astype(np.float32)).numpy().max() < 0.003
        assert points[:, 2].min() > 4.0  # clear of traffic below
        assert points[:4, 2].min() > points[4:, 2].max()  # conductors above cables
        assert (np.diff(points[:4, 0]) > -0.05).all()  # so that wires do not cross
        gaps = np.linalg.norm(points[:, None] - points[None], axis=2)[np.triu_indices(utility_poles.WIRES, 1)]
        assert gaps.min() > 0.18


def tilt(mesh):
    return measure(mesh, TAXONOMY["light_pole"], np.zeros(3)).tilt


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
        low, high = (section_middle(mesh, z) for z in (-0.2, 0.3))
        assert np.degrees(np.arctan2(np.hypot(*(high - low)), 0.5)) == pytest.approx(angle, abs=0.4)


def test_a_planted_lean_and_plate_are_measured():
    metal, base = material("galvanised", "traffic_sign", np.random.default_rng(0)), np.array([120.0, -40.0, 7.0])
    plate, half = sign_plate(np.random.default_rng(3), "square")
    small, _ = sign_plate(np.random.default_rng(3), "square")
    small.vertices[:] *= 0.5
    post = tube([[0, 0, -0.3], [0, 0, 3.2]], 0.04, metal)
    # The large plate faces an azimuth of 110 degrees, the small one the opposite.
    upright = join([
        post, plate.moved([0.06, 0, 2.4], yaw=np.radians(-20)), small.moved([-0.06, 0, 1.2], yaw=np.radians(160)),
    ])  # fmt: skip
    found = measure(upright.moved(base), TAXONOMY["traffic_sign"], base)
    assert found.tilt == pytest.approx(0, abs=1e-4) and found.panels == 2
    assert found.panel_azimuth == pytest.approx(110)
    assert found.panel_centre == pytest.approx(2.4) and found.panel_bottom == pytest.approx(2.4 - half)
    assert found.panel_height == pytest.approx(2 * half) == pytest.approx(found.panel_width)
    np.testing.assert_allclose([found.panel_x, found.panel_y], base[:2] + [0.06, 0], atol=0.01)
    # A rotation by 2 degrees about north leans the top to the east.
    for yaw, lean in ((0.0, 90.0), (90.0, 0.0), (200.0, 250.0)):
        turn = rotation_matrix(np.radians(yaw), 0, 0) @ rotation_matrix(0, np.radians(2.0), 0)
        leant = type(post)(post.vertices @ turn.T + base, post.faces, post.attributes)
        got = measure(leant, TAXONOMY["light_pole"], base)
        assert got.tilt == pytest.approx(2.0, abs=1e-3)
        assert (got.lean_azimuth - lean + 180) % 360 - 180 == pytest.approx(0, abs=0.1)
        assert got.panels == 0 and np.isnan(got.panel_bottom)
    hung = measure(plate.moved(base + [0, 0, 2.5]), TAXONOMY["traffic_sign"], base)
    assert np.isnan(hung.tilt) and hung.panel_centre == pytest.approx(2.5)
    np.testing.assert_array_equal(measure(built("sedan", 0), TAXONOMY["car"], base * 0), Measures())


@pytest.mark.parametrize("shape", SHAPES)
def test_plates_of_signs_face_x_and_have_their_sizes(shape):
    for stream in STREAMS:
        mesh, half = sign_plate(np.random.default_rng([13, stream]), shape)
        [plate] = sign_plates(mesh)  # border, field and marks are one plate
        assert abs(plate.yaw) < 1e-6
        points = used(mesh)
        assert plate.height == pytest.approx(np.ptp(points[:, 2])) == pytest.approx(2 * half)
        assert plate.width == pytest.approx(np.ptp(points[:, 1]))
        assert 0.2 <= plate.width <= 1.4 and 0.2 <= plate.height <= 1.3
        if shape in ("round", "octagon"):
            assert plate.width == pytest.approx(plate.height, rel=0.02)
            assert 0.59 <= plate.width <= 0.91


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


def test_signs_on_posts_face_x_at_their_heights():
    bottoms = []
    for stream in range(40):
        [plate] = sign_plates(DESIGNS["round_sign"].build(np.random.default_rng([14, stream])))
        assert abs(plate.yaw) < 0.4
        bottoms.append(plate.centre[2] - plate.height / 2)
    bottoms = np.array(bottoms)
    assert bottoms.min() > 0.6 and bottoms.max() < 2.6
    assert 0.6 < (bottoms > 1.95).mean() < 0.95


@pytest.mark.parametrize("name", ["lamp_with_sign", "sign_gantry", "cantilever_gantry"])
def test_signs_on_other_poles_face_y(name):
    ahead = []
    for stream in range(12):
        plates = sign_plates(DESIGNS[name].build(np.random.default_rng([15, stream])))
        assert plates
        for plate in plates:
            assert abs(abs(plate.yaw) - np.pi / 2) < 0.45
            assert plate.centre[2] - plate.height / 2 > (1.9 if name == "lamp_with_sign" else 5.0)
        ahead += [plate.yaw > 0 for plate in plates]
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
def test_signals_face_their_traffic(name, axis):
    # Lenses are the only faces with a saturated colour; red ones for vehicles face +y, for pedestrians +x.
    for stream in STREAMS:
        mesh = built(name, stream)
        rgb = mesh.attributes[:, RED : RED + 3]
        a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        lens = (np.abs(rgb - [0.4, 0.04, 0.03]) < 1e-6).all(axis=1)
        front = normal[lens] @ np.eye(3)[axis] / np.linalg.norm(normal[lens], axis=1)
        assert lens.sum() >= 20
        assert (front > 0.97).sum() >= 20


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
    assert measured[0] < typical < measured[1]  # the recording is of the assumed design
    assert simulated.min() < typical < simulated.max()
