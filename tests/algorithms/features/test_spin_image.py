"""Spin images against their definition, and in closed form on a plane and a line."""

import numpy as np
import pytest
from references.detectors import spin_image

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.features.spin_image import compute_spin_images


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_images_follow_the_definition(rng):
    points = rng.uniform(-1, 1, (300, 3))
    normals = unit(rng.normal(size=(20, 3)))
    for n_radial, n_axial in ((9, 17), (4, 3)):
        found = compute_spin_images(
            points, normals, radius=0.8, n_radial=n_radial, n_axial=n_axial, queries=points[:20]
        )
        wanted = [spin_image(points, points[i], normals[i], 0.8, n_radial, n_axial) for i in range(20)]
        np.testing.assert_allclose(found, wanted, atol=1e-6)
        np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=1e-5)


def test_a_plane_lies_in_the_middle_and_a_line_along_the_axis():
    grid = np.arange(-20, 21) * 0.05
    plane = np.column_stack([np.repeat(grid, 41), np.tile(grid, 41), np.zeros(41 * 41)])
    image = compute_spin_images(plane, [[0, 0, 1.0]], radius=1.0, queries=[[0, 0, 0.0]])[0].reshape(9, 17)
    assert image[:, 8].sum() == pytest.approx(1.0)
    assert image[6, 8] > 1.5 * image[3, 8] > 0  # rings grow with their radius
    line = np.column_stack([np.zeros((41, 2)), grid])
    image = compute_spin_images(line, [[0, 0, 1.0]], radius=1.0, queries=[[0, 0, 0.0]])[0].reshape(9, 17)
    assert image[0].sum() == pytest.approx(1.0)


def test_turning_everything_changes_nothing_and_a_turned_normal_mirrors(rng):
    points, normals = rng.normal(size=(200, 3)), unit(rng.normal(size=(200, 3)))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    one = compute_spin_images(points, normals, radius=1.0)
    other = compute_spin_images(points @ turn.T, normals @ turn.T, radius=1.0)
    np.testing.assert_allclose(one, other, atol=2e-5)
    mirrored = compute_spin_images(points, -normals, radius=1.0).reshape(200, 9, 17)[:, :, ::-1]
    np.testing.assert_allclose(one.reshape(200, 9, 17), mirrored, atol=1e-6)


def test_threads_and_missing_normals(rng):
    points, normals = rng.normal(size=(300, 3)), unit(rng.normal(size=(300, 3)))
    normals[5] = np.nan
    one = compute_spin_images(points, normals, radius=0.7)
    assert one.tobytes() == compute_spin_images(points, normals, radius=0.7, n_threads=2).tobytes()
    assert (one[5] == 0).all() and one.dtype == np.float32
    assert (compute_spin_images(points[:1], normals[:1], radius=0.7) == 0).all()
    assert compute_spin_images(np.zeros((0, 3)), np.zeros((0, 3)), radius=0.7).shape == (0, 153)


def test_bad_input(rng):
    points = rng.normal(size=(5, 3))
    with pytest.raises(DataError, match=r"normals .*got \(4, 3\)"):
        compute_spin_images(points, points[:4], radius=1.0)
    with pytest.raises(ParameterError, match=r"n_axial .*got 1"):
        compute_spin_images(points, points, radius=1.0, n_axial=1)
    with pytest.raises(ParameterError, match=r"radius .*got 0"):
        compute_spin_images(points, points, radius=0)
