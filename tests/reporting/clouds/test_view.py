"""Views: projection of points in closed form."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.reporting.clouds.view import birds_eye_view, look_at, main_azimuth, oblique_view

UTM = np.array([431_000.0, 4_583_000.0, 70.0])


def project(xyz, view):
    """Project one point at a time, as the class says."""
    pixels = []
    for point in xyz:
        x, y, z = view.rotation @ (point - view.centre)
        zoom = view.scale / z if view.perspective else view.scale
        pixels.append((x * zoom + view.size[0] / 2, y * zoom + view.size[1] / 2))
    return np.array(pixels)


@pytest.fixture
def street(rng):
    return rng.random((500, 3)) * [80, 12, 6]


def turned(xyz, degrees):
    angle = np.radians(degrees)
    matrix = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return xyz @ matrix.T


@pytest.mark.parametrize("yaw", [0, 30, -75])
def test_main_azimuth_follows_the_street(street, yaw):
    assert main_azimuth(turned(street, yaw)) == pytest.approx(main_azimuth(street) + yaw, abs=1e-6)
    assert abs(main_azimuth(street)) < 3


def test_no_direction_stands_out():
    assert main_azimuth(np.array([[1.0, 2.0, 3.0]])) == 0.0


@pytest.mark.parametrize("yaw", [0, 57])
def test_birds_eye_view_holds_all_points_and_wastes_little(street, yaw):
    xyz = turned(street, yaw) + UTM
    view = birds_eye_view(xyz, width=800)
    pixels = project(xyz, view)
    assert (pixels >= 0).all()
    assert (pixels <= view.size).all()
    assert np.ptp(pixels[:, 0]) > 0.9 * 800
    assert 800 / 4 <= view.size[1] < 800
    assert not view.perspective


def test_birds_eye_view_with_north_on_top_maps_metres_to_pixels():
    square = np.array([[0.0, 0, 0], [10, 0, 0], [0, 10, 0], [10, 10, 5]])
    view = birds_eye_view(square, width=520, height=520, azimuth=0.0)
    pixels = project(square, view)
    assert view.scale == pytest.approx(50.0)
    np.testing.assert_allclose(pixels, [[10, 510], [510, 510], [10, 10], [510, 10]], atol=1e-9)
    assert view.centre[2] == 5.0


def test_trim_leaves_stray_points_outside(street):
    stray = np.vstack([street, [[5000.0, 5000.0, 0.0]]])
    far, near = birds_eye_view(stray, azimuth=0.0), birds_eye_view(stray, azimuth=0.0, trim=0.01)
    assert near.scale > 20 * far.scale


def test_look_at_puts_the_target_in_the_middle_and_up_upwards():
    view = look_at([0, -10, 5], [0, 0, 5], size=(100, 80), field_of_view=90.0)
    np.testing.assert_allclose(project(np.array([[0, 0, 5.0]]), view), [[50, 40]])
    # 90 degrees across: at 10 m distance the picture's edge is 10 m from its middle
    np.testing.assert_allclose(project(np.array([[10, 0, 5.0], [0, 0, 6.0]]), view), [[100, 40], [50, 35]])
    np.testing.assert_allclose(view.rotation @ view.rotation.T, np.eye(3), atol=1e-12)


def test_looking_straight_down_is_no_special_case():
    view = look_at([0, 0, 10], [0, 0, 0], size=(100, 100))
    assert np.isfinite(view.rotation).all()
    np.testing.assert_allclose(abs(np.linalg.det(view.rotation)), 1)


def test_oblique_view_sees_the_middle_of_the_street(street):
    xyz = street + UTM
    view = oblique_view(xyz, size=(640, 360))
    middle = np.median(xyz, axis=0)
    pixel = project(middle[None], view)[0]
    assert (np.abs(pixel - [320, 180]) < 60).all()
    assert view.perspective


def test_what_cannot_be_viewed_is_named():
    with pytest.raises(DataError, match="at least 1 points"):
        birds_eye_view(np.zeros((0, 3)))
    with pytest.raises(DataError, match="NaN or infinite"):
        birds_eye_view(np.full((2, 3), np.nan))
