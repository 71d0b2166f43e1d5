"""Gaussian images of planted normals, and the turn between two of them against trying all."""

import numpy as np
import pytest
from references.detectors import similarity_of_turn

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.features.gaussian_image import align_gaussian_images, compute_gaussian_images


def turned(normals, angle):
    c, s = np.cos(angle), np.sin(angle)
    return normals @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T


def test_a_wall_has_two_opposite_directions():
    normals = np.tile([1.0, 0.0, 0.0], (10, 1))
    image = compute_gaussian_images(normals, [0, 10, 10], n_azimuths=8, n_bands=4)
    wanted = np.zeros((2, 4, 8))
    wanted[0, 0, [0, 4]] = 0.5
    np.testing.assert_allclose(image, wanted, atol=1e-6)
    flipped = compute_gaussian_images(-normals, [0, 10], n_azimuths=8, n_bands=4)
    np.testing.assert_allclose(flipped[0], wanted[0], atol=1e-6)


def test_a_roof_has_no_azimuth():
    image = compute_gaussian_images([[0, 0, 1.0], [0, 0, -1.0], [0.03, 0, 0.9995]], [0, 3], n_azimuths=8, n_bands=4)
    np.testing.assert_allclose(image[0, 3], 1 / 8, atol=1e-6)


def test_cells_have_equal_areas(rng):
    normals = rng.normal(size=(200_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    image = compute_gaussian_images(normals, [0, len(normals)])[0]
    np.testing.assert_allclose(image, 1 / image.size, rtol=0.12)


def test_the_best_turn_is_that_of_trying_all(rng):
    images, references = rng.random((3, 5, 36)), rng.random((2, 5, 36))
    turns, similarity = align_gaussian_images(images, references)
    for m in range(3):
        for r in range(2):
            every = [similarity_of_turn(images[m], references[r], turn) for turn in range(18)]
            assert turns[m, r] == np.argmax(every)
            assert similarity[m, r] == pytest.approx(max(every), abs=1e-6)


def test_a_turned_object_is_turned_back(rng):
    normals = rng.normal(size=(60, 3)) * [1.0, 0.2, 0.5]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    one = compute_gaussian_images(normals, [0, 60])
    for cells in (0, 5, 13):
        other = compute_gaussian_images(turned(normals, np.radians(10 * cells)), [0, 60])
        turns, similarity = align_gaussian_images(other, one)
        assert turns[0, 0] == cells and similarity[0, 0] == pytest.approx(1.0, abs=1e-5)


def test_empty_images_and_bad_input():
    empty = compute_gaussian_images(np.full((3, 3), np.nan), [0, 3])
    assert (empty == 0).all()
    assert align_gaussian_images(empty, empty)[1] == 0
    with pytest.raises(DataError, match=r"normals .*got \(3,\)"):
        compute_gaussian_images(np.zeros(3), [0, 3])
    with pytest.raises(DataError, match="indptr must rise from 0 to the 2 normals"):
        compute_gaussian_images(np.zeros((2, 3)), [0, 3])
    with pytest.raises(ParameterError, match=r"n_azimuths .*got 5"):
        compute_gaussian_images(np.zeros((0, 3)), [0], n_azimuths=5)
    with pytest.raises(DataError, match="cannot be aligned"):
        align_gaussian_images(np.zeros((1, 2, 4)), np.zeros((1, 2, 6)))
