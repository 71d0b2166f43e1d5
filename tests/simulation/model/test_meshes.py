import numpy as np
import pytest
from references.simulator import enclosed_volume

from mlsroad_pipeline.simulation.furnishing.overhead import wire
from mlsroad_pipeline.simulation.model.materials import car_paint
from mlsroad_pipeline.simulation.model.meshes import Surface, join, rotation_matrix
from mlsroad_pipeline.simulation.model.solids import box, ellipsoid, plate, polygon, tube

GREY = Surface(77, (0.5, 0.5, 0.5), 0.5)


def test_box_encloses_its_volume():
    mesh = box([2.0, 3.0, 4.0], [10.0, 0.0, -1.0], GREY)
    assert enclosed_volume(mesh.vertices, mesh.faces) == pytest.approx(24.0)
    np.testing.assert_allclose(mesh.vertices.min(axis=0), [9.0, -1.5, -3.0])


def test_tube_encloses_a_prism():
    # An 8-gon of circumradius r has the area 4 r^2 sin(45 degrees).
    mesh = tube([[0, 0, 0], [0, 0, 1.2], [0, 0, 5.0]], 0.3, GREY, sides=8)
    expected = 4 * 0.3**2 * np.sin(np.pi / 4) * 5.0
    assert abs(enclosed_volume(mesh.vertices, mesh.faces)) == pytest.approx(expected)


def test_ellipsoid_approaches_the_closed_form():
    mesh = ellipsoid([1, 2, 3], [0.5, 1.0, 2.0], GREY, rings=60, sides=60)
    assert abs(enclosed_volume(mesh.vertices, mesh.faces)) == pytest.approx(4 / 3 * np.pi * 1.0, rel=0.01)


def test_plate_shows_its_front_towards_minus_y():
    front, back = Surface(42, (1, 0, 0), 0.9), Surface(42, (0, 1, 0), 0.1)
    mesh = plate(polygon(6, 1.0), front, back, thickness=0.02)
    y = mesh.vertices[mesh.faces].mean(axis=1)[:, 1]
    assert (y[mesh.attributes[:, 2] == 1] < 0).all()
    assert (y[mesh.attributes[:, 3] == 1] > 0).all()


def test_rotation_turns_x_to_y_and_keeps_lengths():
    np.testing.assert_allclose(rotation_matrix(np.pi / 2, 0, 0) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(rotation_matrix(0, 0.1, 0) @ [1, 0, 0], [np.cos(0.1), 0, -np.sin(0.1)])
    np.testing.assert_allclose(rotation_matrix(0, 0, 0.1) @ [0, 1, 0], [0, np.cos(0.1), np.sin(0.1)])
    turn = rotation_matrix(0.3, -0.2, 1.1)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-14)


def test_joined_faces_point_to_their_own_vertices():
    a, b = box([1, 1, 1], [0, 0, 0], GREY), box([1, 1, 1], [9, 0, 0], GREY)
    both = join([a, b])
    assert both.vertices[both.faces[12:]][..., 0].min() == 8.5
    assert len(join([]).faces) == 0


def test_cars_are_mostly_without_a_hue():
    rng = np.random.default_rng(0)
    rgb = np.array([car_paint("car", rng).rgb for _ in range(1500)])
    hue = np.ptp(rgb, axis=1) / rgb.max(axis=1)
    assert (hue < 0.35).mean() == pytest.approx(0.77, abs=0.05)
    bright = rgb[hue < 0.35].mean(axis=1)
    assert (bright > 0.55).mean() > 0.2 and (bright < 0.06).mean() > 0.1


def test_wire_hangs_by_its_sag():
    mesh = wire([0, 0, 8.0], [30, 0, 9.0], 0.6, 0.01, np.random.default_rng(0))
    middle = mesh.vertices[np.abs(mesh.vertices[:, 0] - 15) < 0.1]
    assert middle[:, 2].mean() == pytest.approx(8.5 - 0.6, abs=0.01)
