"""The voxel grid against dictionaries and SciPy."""

import numpy as np
import pytest
from references import vccs as reference
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.geometry.voxels import build_voxel_grid


@pytest.fixture(scope="module")
def cloud():
    rng = np.random.default_rng(8)
    return np.concatenate([rng.uniform(-3, 3, (2000, 3)), rng.uniform(0, 0.3, (500, 3)), np.full((20, 3), 1.5)])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("n_threads", [1, 3])
def test_equals_the_dictionary(cloud, dtype, n_threads):
    xyz = cloud.astype(dtype)
    grid = build_voxel_grid(xyz, voxel_size=0.25, n_threads=n_threads)
    expected, _ = reference.voxelise(xyz, 0.25)
    found = {}
    for i, v in enumerate(grid.voxel_of_point):
        found.setdefault(int(v), []).append(i)
    assert sorted(map(tuple, found.values())) == sorted(map(tuple, expected.values()))
    assert len(grid) == len(expected)
    low = np.min(list(expected), axis=0)
    by_place = {tuple((np.array(c) - low).tolist()): points for c, points in expected.items()}
    for v, c in enumerate(grid.coords.tolist()):
        assert by_place[tuple(c)] == found[v]
        np.testing.assert_allclose(grid.centroids[v], xyz[found[v]].mean(axis=0), atol=1e-6)
        assert grid.counts[v] == len(found[v])
        assert grid.order[grid.indptr[v] : grid.indptr[v + 1]].tolist() == found[v]


@pytest.mark.parametrize("n_threads", [1, 2])
def test_neighbours_are_those_of_a_tree(cloud, n_threads):
    grid = build_voxel_grid(cloud, voxel_size=0.25)
    indptr, indices = grid.neighbors(n_threads=n_threads)
    tree = cKDTree(grid.coords).query_ball_point(grid.coords, 1, p=np.inf)
    for v in range(len(grid)):
        row = indices[indptr[v] : indptr[v + 1]]
        assert sorted([*row.tolist(), v]) == sorted(tree[v])
        steps = (grid.coords[row] - grid.coords[v]).tolist()
        assert steps == sorted(steps)


def test_find(cloud):
    grid = build_voxel_grid(cloud, voxel_size=0.25)
    assert (grid.find(grid.coords) == np.arange(len(grid))).all()
    ids = {tuple(c): v for v, c in enumerate(grid.coords.tolist())}
    asked = np.random.default_rng(1).integers(-40, 60, (3000, 3))
    assert grid.find(asked).tolist() == [ids.get(tuple(c), -1) for c in asked.tolist()]
    assert grid.find([[2**40, 0, 0], [-1, -1, -1]]).tolist() == [-1, -1]
    with pytest.raises(DataError, match=r"integers of shape \(m, 3\), got float64"):
        grid.find([[0.5, 0, 0]])


def test_many_bricks_outgrow_the_first_table(rng):
    xyz = rng.uniform(0, 1000, (20_000, 3))
    grid = build_voxel_grid(xyz, voxel_size=1.0, n_threads=2)
    cells = np.floor((xyz - grid.origin) / 1.0).astype(int)
    assert (grid.coords[grid.voxel_of_point] == cells).all()
    assert len(grid) == len(np.unique(cells, axis=0))


def test_order_and_threads_leave_no_trace(cloud, rng):
    shuffle = rng.permutation(len(cloud))
    a = build_voxel_grid(cloud, voxel_size=0.25)
    b = build_voxel_grid(cloud[shuffle], voxel_size=0.25, n_threads=2)
    assert a.local_centroids.tobytes() == b.local_centroids.tobytes()
    assert a.coords.tobytes() == b.coords.tobytes() and a.counts.tobytes() == b.counts.tobytes()
    assert (a.voxel_of_point[shuffle] == b.voxel_of_point).all()


def test_anchor_puts_a_corner_there(cloud):
    anchor = np.array([0.1, -0.2, 0.05])
    grid = build_voxel_grid(cloud, voxel_size=0.25, anchor=anchor)
    steps = (grid.origin - anchor) / 0.25
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)
    part = build_voxel_grid(cloud[cloud[:, 0] > 0], voxel_size=0.25, anchor=anchor)
    shift = np.rint((part.origin - grid.origin) / 0.25).astype(int)
    assert (grid.find(part.coords + shift) >= 0).all()


def test_utm_coordinates_keep_their_voxels(cloud):
    a = build_voxel_grid(cloud, voxel_size=0.25)
    b = build_voxel_grid(cloud + np.array([5e5, 5e6, 300.0]), voxel_size=0.25)
    assert (a.voxel_of_point == b.voxel_of_point).all()
    np.testing.assert_allclose(b.centroids - [5e5, 5e6, 300.0], a.centroids, atol=1e-6)


@pytest.mark.parametrize(
    ("keywords", "error", "message"),
    [
        ({"voxel_size": -1.0}, ParameterError, "voxel_size must be .* got -1.0"),
        ({"voxel_size": 1e-8}, ParameterError, "voxel_size 1e-08 is too small"),
        ({"n_threads": 1.5}, ParameterError, "n_threads must be an integer, got 1.5"),
        ({"anchor": [0, np.nan, 0]}, DataError, "anchor must be three finite coordinates"),
        ({"anchor": [0, 0]}, DataError, "anchor must be three finite coordinates"),
    ],
)
def test_bad_parameters_are_named(cloud, keywords, error, message):
    with pytest.raises(error, match=message):
        build_voxel_grid(cloud, **{"voxel_size": 0.25, **keywords})
