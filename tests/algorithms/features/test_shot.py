"""SHOT and layers against their definitions, and under turns."""

import numpy as np
import pytest
from references.shot import layers, shot

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.features.layers import describe_layers
from mlsroad_pipeline.algorithms.features.shot import SIZE, compute_shot, local_reference_frame


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.fixture
def cloud(rng):
    return rng.normal(size=(301, 3)) * [1.0, 0.6, 0.3] + [0.1, 0.05, 0.02]


def test_shot_follows_the_definition(cloud, rng):
    normals = unit(rng.normal(size=cloud.shape))
    for radius in (0.8, 3.0):
        found = compute_shot(cloud, normals, np.zeros(3), radius=radius)
        np.testing.assert_allclose(found, shot(cloud, normals, radius), atol=1e-6)
    assert found.shape == (SIZE,) and SIZE == 352
    assert np.linalg.norm(found) == pytest.approx(1.0, abs=1e-6)


def test_shot_turns_and_moves_with_the_points(cloud, rng):
    normals = unit(rng.normal(size=cloud.shape))
    one = compute_shot(cloud, normals, np.zeros(3), radius=2.0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    shift = np.array([400.0, -80.0, 20.0])
    other = compute_shot(cloud @ turn.T + shift, normals @ turn.T, shift, radius=2.0)
    np.testing.assert_allclose(one, other, atol=1e-5)
    frame = local_reference_frame(cloud, 2.0)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    np.testing.assert_allclose(local_reference_frame(cloud @ turn.T, 2.0), frame @ turn.T, atol=1e-9)


def test_shot_of_a_floor_has_one_bin_of_cosine(rng):
    floor = np.column_stack([rng.uniform(-1, 1, (400, 2)), np.zeros(400)])
    up = np.tile([0, 0, 1.0], (400, 1))
    found = compute_shot(floor, up, np.zeros(3), radius=1.5).reshape(-1, 11)
    used = np.flatnonzero(found.sum(axis=0) > 0)
    assert len(used) == 1 and used[0] in (0, 10)


def test_shot_without_normals_is_zero(cloud):
    assert (compute_shot(cloud, np.full(cloud.shape, np.nan), np.zeros(3), radius=1.0) == 0).all()
    assert (compute_shot(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(3), radius=1.0) == 0).all()
    with pytest.raises(ParameterError, match=r"radius .*got 0"):
        compute_shot(cloud, cloud, np.zeros(3), radius=0)
    with pytest.raises(DataError, match=r"normals must have shape \(301, 3\)"):
        compute_shot(cloud, cloud[:4], np.zeros(3), radius=1.0)


def test_layers_follow_the_definition_and_do_not_turn(cloud):
    found = describe_layers([cloud, cloud[:40]], n_layers=10)
    np.testing.assert_allclose(found[0], layers(cloud, 10), atol=1e-5)
    np.testing.assert_allclose(found[1], layers(cloud[:40], 10), atol=1e-5)
    assert found.shape == (2, 100)
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    moved = describe_layers([cloud @ turn.T + [4e5, 5e6, 30]])
    np.testing.assert_allclose(moved, found[:1], atol=1e-4)
    np.testing.assert_allclose(found.reshape(2, 10, 10)[:, :, 0].sum(axis=1), 1.0, atol=1e-6)


def test_layers_of_hardly_anything(rng):
    found = describe_layers([np.full((3, 3), 2.0), rng.normal(size=(1, 3))], n_layers=4)
    assert np.isfinite(found).all() and found.reshape(2, 4, 10)[:, 0, 0].tolist() == [1.0, 1.0]
    with pytest.raises(ParameterError, match=r"n_layers .*got 0"):
        describe_layers([np.zeros((1, 3))], n_layers=0)
