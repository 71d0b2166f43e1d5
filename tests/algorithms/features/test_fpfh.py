"""Histograms against Open3D, a pair by pair re-implementation and closed forms."""

import laspy
import numpy as np
import open3d as o3d
import pytest
from references.patches import fpfh

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.features.fpfh import compute_fpfh
from mlsroad_pipeline.algorithms.features.normals import compute_normals

OPEN3D_SUM = 600.0
"""Open3D's histograms sum to 200 for each of three features."""


def open3d_histograms(xyz, normals, radius):
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.asarray(xyz, dtype=np.float64)))
    cloud.normals = o3d.utility.Vector3dVector(np.asarray(normals, dtype=np.float64))
    search = o3d.geometry.KDTreeSearchParamRadius(radius)
    return np.asarray(o3d.pipelines.registration.compute_fpfh_feature(cloud, search).data).T


def random_cloud(rng, n):
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return rng.random((n, 3)).astype(np.float32), normals.astype(np.float32)


def test_random_normals_give_open3ds_histograms(rng):
    xyz, normals = random_cloud(rng, 2000)
    ours, theirs = compute_fpfh(xyz, normals, radius=0.16), open3d_histograms(xyz, normals, 0.16)
    differs = (np.abs(ours * OPEN3D_SUM - theirs) > 1e-4).any(axis=1)
    assert differs.mean() < 0.002  # a pair at a bin's edge or at the radius, in float32 and in float64
    assert np.abs(ours * OPEN3D_SUM - theirs).max() < 2.0


def test_street_gives_open3ds_histograms(real_data):
    points = np.asarray(laspy.read(next(real_data("jakarto").glob("*.las"))).xyz)
    xyz = points - points.mean(axis=0)
    normals = compute_normals(xyz, k=20)
    known = np.isfinite(normals).all(axis=1)
    xyz, normals = xyz[known].astype(np.float32), normals[known]
    ours, theirs = compute_fpfh(xyz, normals, radius=0.4), open3d_histograms(xyz, normals, 0.4)
    differs = (np.abs(ours * OPEN3D_SUM - theirs) > 1e-3).any(axis=1)
    assert len(xyz) > 10_000 and differs.mean() < 0.001


@pytest.mark.parametrize(("n_bins", "use_distance"), [(11, False), (4, True), (1, True)])
def test_any_number_of_bins_and_the_distance_follow_the_definition(rng, n_bins, use_distance):
    xyz, normals = random_cloud(rng, 120)
    found = compute_fpfh(xyz, normals, radius=0.3, n_bins=n_bins, use_distance=use_distance)
    expected = fpfh(xyz.astype(np.float64), normals.astype(np.float64), 0.3, n_bins, use_distance)
    assert found.shape == (120, n_bins * (3 + use_distance)) and found.dtype == np.float32
    assert (np.abs(found - expected) > 1e-5).any(axis=1).mean() <= 0.01


def test_points_at_one_place_and_parallel_normals_follow_open3d(rng):
    step = rng.random((600, 3)).astype(np.float32) * [2, 2, 0]
    step[:300, 2] = 0.1  # normals are equal and lines are not across them: the first point is the source
    step = np.concatenate([step, step[:40]])
    normals = np.tile(np.float32([0, 0, 1]), (len(step), 1))
    ours, theirs = compute_fpfh(step, normals, radius=0.3), open3d_histograms(step, normals, 0.3)
    assert np.abs(ours * OPEN3D_SUM - theirs).max() < 1e-4


def test_plane_puts_all_pairs_into_the_middle_bins():
    x, y = np.meshgrid(np.arange(20) * 0.1, np.arange(20) * 0.1)
    plane = np.column_stack([x.ravel(), y.ravel(), np.zeros(400)])
    found = compute_fpfh(plane, np.tile([0.0, 0.0, 1.0], (400, 1)), radius=0.25)
    expected = np.zeros(33)
    expected[[5, 16, 27]] = 1 / 3
    assert np.abs(found - expected).max() < 1e-6


def test_every_row_sums_to_one_but_for_points_without_neighbours_or_normals(rng):
    xyz, normals = random_cloud(rng, 500)
    xyz[7] += 100
    normals[11] = np.nan
    found = compute_fpfh(xyz, normals, radius=0.3, n_bins=5, use_distance=True)
    alone = np.isin(np.arange(500), [7, 11])
    assert np.allclose(found[~alone].sum(axis=1), 1, atol=1e-5) and not found[alone].any()
    without = np.delete(np.arange(500), 11)  # it is nobody's neighbour
    again = compute_fpfh(xyz[without], normals[without], radius=0.3, n_bins=5, use_distance=True)
    assert np.array_equal(again, found[without])


def test_normals_face_up_or_the_viewpoint(rng):
    wall = np.column_stack([rng.uniform(0, 4, 800), rng.normal(0, 0.002, 800), rng.uniform(0, 4, 800)])
    seen = compute_normals(wall, radius=0.6, viewpoint=[2.0, -10.0, 2.0])
    assert (seen[:, 1] < -0.99).all()
    road = wall[:, [0, 2, 1]]
    assert (compute_normals(road, k=15)[:, 2] > 0.99).all()
    assert (compute_normals(road, k=15, viewpoint=[2, 2, -5])[:, 2] < -0.99).all()
    assert np.isnan(compute_normals(wall[:2], radius=1.0)).all()


def test_bad_input_is_named(rng):
    xyz, normals = random_cloud(rng, 10)
    with pytest.raises(ParameterError, match=r"n_bins .*got 0"):
        compute_fpfh(xyz, normals, radius=0.1, n_bins=0)
    with pytest.raises(ParameterError, match=r"radius .*got -1"):
        compute_fpfh(xyz, normals, radius=-1)
    with pytest.raises(ParameterError, match=r"n_threads .*got 0"):
        compute_fpfh(xyz, normals, radius=0.1, n_threads=0)
    with pytest.raises(DataError, match=r"normals .*got \(9, 3\)"):
        compute_fpfh(xyz, normals[:9], radius=0.1)
    with pytest.raises(DataError, match=r"viewpoint .*got \[1, 2\]"):
        compute_normals(xyz, k=3, viewpoint=[1, 2])
    assert compute_fpfh(np.zeros((0, 3)), np.zeros((0, 3)), radius=1).shape == (0, 33)
