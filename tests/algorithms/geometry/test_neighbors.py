"""Neighbourhoods against SciPy and brute force."""

import itertools

import numpy as np
import pytest
from references.forest import radius_lists

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.geometry.neighbors import nearest_neighbors, radius_neighbors

UTM = np.array([451_234.5, 5_412_987.25, 312.0])


def as_lists(indices, indptr):
    return [indices[a:b].tolist() for a, b in itertools.pairwise(indptr)]


@pytest.mark.parametrize("radius", [0.05, 0.4, 5.0])
@pytest.mark.parametrize("offset", [0.0, UTM])
def test_radius_neighbors_equal_scipy(rng, radius, offset):
    xyz = rng.random((400, 3)) * [3, 2, 1] + offset
    indices, indptr = radius_neighbors(xyz, radius=radius)
    assert indices.dtype == np.int32
    assert indptr.dtype == np.int64
    assert as_lists(indices, indptr) == radius_lists(xyz, radius)


def test_radius_neighbors_of_other_queries_equal_scipy(rng):
    xyz = rng.random((300, 3))
    queries = rng.random((200, 3)) * 3 - 1  # many of them far outside
    indices, indptr = radius_neighbors(xyz, radius=0.3, queries=queries)
    assert as_lists(indices, indptr) == radius_lists(xyz, 0.3, queries)


def test_a_point_at_exactly_the_radius_is_a_neighbor():
    lattice = np.stack(np.meshgrid(*[np.arange(5.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    indices, indptr = radius_neighbors(lattice, radius=1.0)
    centre = 2 * 25 + 2 * 5 + 2
    assert np.diff(indptr)[centre] == 7
    assert as_lists(indices, indptr) == radius_lists(lattice, 1.0)


def test_neighbors_do_not_depend_on_threads_and_leave_the_input_alone(rng):
    xyz = rng.random((2000, 3))
    before = xyz.copy()
    one, two = radius_neighbors(xyz, radius=0.1), radius_neighbors(xyz, radius=0.1, n_threads=2)
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))
    one, two = nearest_neighbors(xyz, k=5), nearest_neighbors(xyz, k=5, n_threads=2)
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))
    assert np.array_equal(xyz, before)


def test_nearest_neighbors_equal_brute_force(rng):
    xyz, queries = rng.random((200, 3)), rng.random((50, 3))
    indices, indptr = nearest_neighbors(xyz, k=7, queries=queries)
    distances = np.linalg.norm(xyz[None] - queries[:, None], axis=2)
    assert np.array_equal(indices.reshape(50, 7), np.argsort(distances, axis=1)[:, :7])
    assert np.array_equal(indptr, np.arange(51) * 7)


def test_nearest_neighbors_break_ties_by_index():
    xyz = np.zeros((6, 3))
    xyz[3:, 0] = 1.0
    indices, _ = nearest_neighbors(xyz, k=6)
    assert indices.reshape(6, 6).tolist() == [[0, 1, 2, 3, 4, 5]] * 3 + [[3, 4, 5, 0, 1, 2]] * 3


def test_fewer_points_than_k_gives_all_of_them():
    indices, indptr = nearest_neighbors(np.eye(3), k=10)
    assert np.diff(indptr).tolist() == [3, 3, 3]
    assert sorted(indices[:3].tolist()) == [0, 1, 2]


@pytest.mark.parametrize("search", [lambda x: radius_neighbors(x, radius=1.0), lambda x: nearest_neighbors(x, k=2)])
def test_no_points_and_one_point(search):
    indices, indptr = search(np.empty((0, 3)))
    assert (len(indices), indptr.tolist()) == (0, [0])
    indices, indptr = search(np.zeros((1, 3)))
    assert (indices.tolist(), indptr.tolist()) == ([0], [0, 1])


def test_queries_without_points_have_no_neighbors():
    indices, indptr = radius_neighbors(np.empty((0, 3)), radius=1.0, queries=np.zeros((2, 3)))
    assert (len(indices), indptr.tolist()) == (0, [0, 0, 0])


def test_bad_input_is_named():
    bad = np.array([[0.0, 0.0, 0.0], [np.nan, 0.0, 0.0]])
    with pytest.raises(DataError, match=r"NaN or infinite coordinates, the first at row 1"):
        radius_neighbors(bad, radius=1.0)
    with pytest.raises(DataError, match=r"queries has 1 points with NaN"):
        nearest_neighbors(np.zeros((2, 3)), k=1, queries=bad)
    with pytest.raises(ParameterError, match=r"radius .*got -1"):
        radius_neighbors(np.zeros((2, 3)), radius=-1)
    with pytest.raises(ParameterError, match=r"k must be at least 1, got 0"):
        nearest_neighbors(np.zeros((2, 3)), k=0)
    with pytest.raises(ParameterError, match=r"n_threads .*got 0"):
        radius_neighbors(np.zeros((2, 3)), radius=1.0, n_threads=0)
    with pytest.raises(ParameterError, match=r"n_threads .*got 0"):
        nearest_neighbors(np.zeros((2, 3)), k=1, n_threads=0)
