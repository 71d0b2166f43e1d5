"""The hull against Qhull's, on clouds of several kinds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from mlsroad_pipeline.papers.tomic2019.image_labels import visibility
from mlsroad_pipeline.papers.tomic2019.image_labels.convex_hull import hull_vertices, insertion_order


def on_sphere(rng, n):
    xyz = rng.normal(size=(n, 3))
    return xyz / np.linalg.norm(xyz, axis=1, keepdims=True)


def flip(seen, exponent):
    """Return the spherical flip of points around the viewpoint 0, and the viewpoint first."""
    distance = np.linalg.norm(seen, axis=1, keepdims=True)
    return np.concatenate([np.zeros((1, 3)), seen * (2 * distance.max() * 10**exponent / distance - 1)])


def street(rng, n):
    """Return points of a road and a front beside it as recorded to the millimetre, the eye 2.4 m above the road."""
    road = np.column_stack([rng.uniform(-40, 40, n), rng.uniform(-5, 5, n), np.full(n, -2.4)])
    front = np.column_stack([rng.uniform(-40, 40, n), np.full(n, 6.0), rng.uniform(-2.4, 8, n)])
    return np.round(np.where(rng.uniform(size=(n, 1)) < 0.5, road, front), 3)


KINDS = {
    "ball": lambda rng, n: rng.normal(size=(n, 3)) * [5.0, 1.0, 0.2],
    "sphere": on_sphere,
    "flip of a cloud aside": lambda rng, n: flip(rng.normal(size=(n, 3)) + [8.0, 0, 0], rng.uniform(1, 5)),
    "flip of a cloud around": lambda rng, n: flip(rng.normal(size=(n, 3)) * [9.0, 5.0, 3.0], rng.uniform(0, 5)),
    "flip of a street": lambda rng, n: flip(street(rng, n), rng.uniform(1, 5)),
}


@given(kind=st.sampled_from(sorted(KINDS)), n=st.integers(5, 500), seed=st.integers(0, 2**32 - 1), copies=st.booleans())
@settings(max_examples=60, deadline=None)
def test_vertices_are_those_of_qhull(kind, n, seed, copies):
    rng = np.random.default_rng(seed)
    xyz = KINDS[kind](rng, n)
    rows = np.concatenate([np.arange(len(xyz)), rng.integers(0, len(xyz), n if copies else 0)])
    found = hull_vertices(xyz[rows])
    assert found is not None
    assert np.array_equal(found, np.sort(ConvexHull(xyz).vertices))  # of equal points the first


@given(n=st.integers(8, 400), side=st.integers(2, 5), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_points_of_a_lattice_have_the_corners_of_qhull(n, side, seed):
    """Many in one plane, on one line, and equal: others may lie on the surface, and none is left out."""
    xyz = np.random.default_rng(seed).integers(0, side, (n, 3)).astype(float)
    found = hull_vertices(xyz)
    if np.linalg.matrix_rank(xyz - xyz[0]) < 3:
        assert found is None
        return
    hull = ConvexHull(xyz)
    corners = {tuple(point) for point in xyz[found]}
    assert corners >= {tuple(point) for point in xyz[hull.vertices]}
    heights = xyz[found] @ hull.equations[:, :3].T + hull.equations[:, 3]
    np.testing.assert_allclose(heights.max(axis=1), 0, atol=1e-9)
    assert len(corners) == len(found)


@pytest.mark.parametrize(
    "xyz",
    [
        np.zeros((6, 3)),
        np.linspace(0, 1, 12)[:, None] * [3.0, 1.0, 2.0],
        np.random.default_rng(1).uniform(size=(50, 2)) @ np.array([[1.0, 2.0, 3.0], [0.0, 1.0, 5.0]]) + 4.0,
    ],
    ids=["one place", "a line", "a plane"],
)
def test_points_of_one_plane_have_none(xyz):
    assert hull_vertices(xyz) is None


def test_points_are_inserted_once_each_the_farthest_of_each_side_first(rng):
    xyz = rng.normal(size=(5000, 3))
    order = insertion_order(np.concatenate([xyz, xyz[:1000]]))
    assert np.array_equal(np.sort(order), np.arange(6000))
    place = np.argsort(order)
    assert (place[:1000] < place[5000:]).all()
    distance = np.linalg.norm(xyz, axis=1)
    assert distance.argmax() in order[: 6 * 4**3]  # the coarsest cells are those of a cube with 3 bits a side
    assert distance[order[:200] % 5000].mean() > distance.mean() + distance.std()


def test_qhull_is_asked_where_rounding_left_no_hull(rng, monkeypatch):
    xyz = rng.normal(size=(500, 3)) + [9.0, 0, 0]
    expected = visibility.hidden_point_removal(xyz, np.zeros(3), radius=1000.0)
    monkeypatch.setattr(visibility, "hull_vertices", lambda points: None)
    assert np.array_equal(visibility.hidden_point_removal(xyz, np.zeros(3), radius=1000.0), expected)
