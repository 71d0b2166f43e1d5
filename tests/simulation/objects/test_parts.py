"""Solids of built objects, against closed forms."""

import numpy as np
import pytest
from references.simulator import enclosed_volume

from mlsroad_pipeline.simulation.model.meshes import Surface
from mlsroad_pipeline.simulation.model.solids import box, polygon, tube
from mlsroad_pipeline.simulation.objects.parts import (
    fan,
    grid_skin,
    lathe,
    leaned,
    loft,
    panel,
    prism,
    rounded,
    tinted,
)

GREY, RED = Surface(77, (0.5, 0.5, 0.5), 0.5), Surface(42, (0.6, 0.1, 0.1), 0.7)


def test_grid_skin_colours_its_cells_and_leaves_holes():
    x, y = np.meshgrid(np.arange(4.0), np.arange(3.0), indexing="ij")
    which = np.array([[0, 1], [-1, 0], [1, 1]])
    mesh = grid_skin(np.stack([x, y, 0 * x], axis=2), [GREY, RED], which)
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    cell = np.floor(middle[:, :2]).astype(int)
    assert len(mesh.faces) == 10
    np.testing.assert_array_equal(mesh.attributes[:, 0], np.where(which[cell[:, 0], cell[:, 1]] == 1, 42, 77))
    assert not ((cell[:, 0] == 1) & (cell[:, 1] == 0)).any()


def test_cells_without_area_are_dropped():
    points = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 0, 0]], [[2, 0, 0], [2, 0, 0]]], dtype=float)
    assert len(grid_skin(points, [GREY]).faces) == 1


def test_lathe_encloses_a_frustum():
    mesh = lathe([[0, 0], [0.5, 0], [0.3, 2.0], [0, 2.0]], GREY, at=[3, -1, 0.5], sides=24)
    share = 24 / (2 * np.pi) * np.sin(2 * np.pi / 24)  # of the circle that its polygon fills
    expected = np.pi * 2.0 / 3 * (0.25 + 0.15 + 0.09) * share
    assert abs(enclosed_volume(mesh.vertices, mesh.faces)) == pytest.approx(expected)
    np.testing.assert_allclose(mesh.vertices[:, 2].max(), 2.5)


def test_loft_and_prism_enclose_their_volumes():
    outline = np.array([[0, 0], [2, 0], [2, 1], [0.5, 1.5]])
    x, z = outline.T
    area = abs(np.sum(x * np.roll(z, -1) - z * np.roll(x, -1))) / 2
    mesh = prism(outline, 0.7, GREY, at=-0.2)
    assert abs(enclosed_volume(mesh.vertices, mesh.faces)) == pytest.approx(0.7 * area)
    np.testing.assert_allclose([mesh.vertices[:, 1].min(), mesh.vertices[:, 1].max()], [-0.55, 0.15])
    square = np.column_stack([polygon(4, np.sqrt(2), start=np.pi / 4), np.zeros(4)])
    pyramid = loft([square, 0.5 * square + np.array([0, 0, 3.0])], GREY)
    assert abs(enclosed_volume(pyramid.vertices, pyramid.faces)) == pytest.approx(3.0 / 3 * (4 + 1 + 2))
    assert len(loft([square, square + np.array([0, 0, 1.0])], GREY, closed=False).faces) == 8


def test_rounded_rectangle_has_its_sides_and_area():
    outline = rounded(2.0, 1.0, 0.2)
    np.testing.assert_allclose(np.ptp(outline, axis=0), [2.0, 1.0])
    x, y = outline.T
    area = np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2  # positive: counter-clockwise
    corner = 0.2**2 * (1 - 2 * np.sin(np.pi / 4) / 2)  # what two chords leave of each corner's square
    assert area == pytest.approx(2.0 - 4 * corner)


def test_panel_faces_its_direction():
    for yaw in (0.0, 0.7, np.pi / 2, -2.5):
        mesh = panel(polygon(5, 0.4), RED, GREY, [1, 2, 3], yaw=yaw)
        look = np.array([np.cos(yaw), np.sin(yaw), 0])
        out = (mesh.vertices[mesh.faces].mean(axis=1) - [1, 2, 3]) @ look
        assert (out[mesh.attributes[:, 0] == 42] > 0).all()
        assert (out[mesh.attributes[:, 0] == 77] < 0).all()


def test_fan_faces_the_side_of_counter_clockwise_corners():
    mesh = fan(np.column_stack([polygon(6, 1.0), np.zeros(6)]), GREY)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    assert (normals[:, 2] > 0).all()
    assert normals[:, 2].sum() / 2 == pytest.approx(6 / 2 * np.sin(np.pi / 3))


def test_leaning_rotates_about_the_foot():
    mast = tube([[0, 0, 0], [0, 0, 8.0]], 0.1, GREY)
    for seed in range(30):
        leant = leaned(mast, np.random.default_rng(seed), share=1.0, limit=3.0)
        foot, head = leant.vertices[-2:]  # the middles of the two ends
        np.testing.assert_allclose(foot, 0, atol=1e-12)
        angle = np.degrees(np.arccos(head[2] / 8.0))
        assert 0.5 <= angle <= 3.0
        assert np.linalg.norm(head) == pytest.approx(8.0)
    upright = [leaned(box([1, 1, 1], [0, 0, 0.5], GREY), np.random.default_rng(k), share=0.0) for k in range(200)]
    drop = np.array(
        [np.degrees(np.arcsin(np.hypot(*(m.vertices[4:, :2].mean(0) - m.vertices[:4, :2].mean(0))))) for m in upright]
    )
    assert np.sqrt((drop**2).mean()) == pytest.approx(0.2, rel=0.15)


def test_tinted_stays_near_its_colour():
    rng = np.random.default_rng(0)
    drawn = np.array(
        [(*s.rgb, s.reflectivity) for s in (tinted((0.3, 0.2, 0.1), "bin", 0.4, rng, spread=0.2) for _ in range(400))]
    )
    np.testing.assert_allclose(np.median(drawn, axis=0), [0.3, 0.2, 0.1, 0.4], rtol=0.05)
    assert np.log(drawn[:, 0]).std() == pytest.approx(0.2 * np.sqrt(1 + 1 / 9), rel=0.12)
    assert np.log(drawn[:, 0] / drawn[:, 1]).std() == pytest.approx(0.2 / 3 * np.sqrt(2), rel=0.12)
