"""Baseline segmentations on planted objects and hand-made scans, and against SciPy's components."""

import numpy as np
import pytest
from references.inventory import radius_graph_components
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist
from sklearn.metrics import adjusted_rand_score

from mlsroad_pipeline.algorithms.core.exceptions import MissingColumnError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.segmentation import two_step
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster_by_spacing
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import NormalizedCutParameters, segment
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters, segment_scene
from mlsroad_pipeline.algorithms.segmentation.two_step import TwoStepParameters, segment_two_step
from mlsroad_pipeline.algorithms.segmentation.yang_dong import (
    LINEAR,
    PLANAR,
    VOLUMETRIC,
    YangDongParameters,
    classify_dimensions,
    segment_yang_dong,
)


def upright(x, y, low, high, step=0.03):
    """A thin pole."""
    z = np.arange(low, high, step)
    return np.column_stack([np.full(len(z), x), np.full(len(z), y), z])


def ball(rng, centre, radius, n):
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.asarray(centre) + direction * radius * rng.random((n, 1)) ** (1 / 3)


def test_spacing_of_zero_is_plain_clustering(rng):
    xyz = rng.uniform(0, 3, (800, 3))
    found = cluster_by_spacing(xyz, tolerance=0.2, spacing_factor=0, max_tolerance=0.5)
    np.testing.assert_array_equal(found, radius_graph_components(xyz, 0.2))


def test_sparse_objects_stay_whole_and_dense_objects_separate():
    """Two dense sheets 0.25 m apart are two objects; one sheet whose points lie 0.3 m apart is one."""
    grid = np.stack(np.meshgrid(np.arange(0, 1, 0.05), np.arange(0, 1, 0.05)), axis=-1).reshape(-1, 2)
    dense = [np.column_stack([grid[:, 0], np.full(len(grid), y), grid[:, 1]]) for y in (0.0, 0.25)]
    sparse = np.column_stack([6 * grid[:, 0], np.full(len(grid), 9.0), 6 * grid[:, 1]])
    found = cluster_by_spacing(np.concatenate([*dense, sparse]), tolerance=0.15, spacing_factor=1.5, max_tolerance=0.5)
    np.testing.assert_array_equal(found, np.repeat([0, 1, 2], len(grid)))


def test_spacing_equals_the_definition_by_all_distances(rng):
    """Places that lie ever farther apart, no two in one voxel."""
    lattice = np.stack(np.meshgrid(np.arange(24), np.arange(12), np.arange(3)), axis=-1).reshape(-1, 3) * 0.2
    xyz = lattice + rng.uniform(-0.03, 0.03, lattice.shape)
    xyz *= 1.0 + 0.3 * xyz[:, :1]
    xyz = xyz[rng.random(len(xyz)) < 0.5]
    far = cdist(xyz, xyz)
    reach = np.minimum(1.5 * np.sort(far, axis=1)[:, 4], 0.5)
    touching = far <= np.maximum(np.minimum(reach[:, None], reach[None]), 0.15)
    expected = connected_components(touching)[1]
    found = cluster_by_spacing(xyz, tolerance=0.15, spacing_factor=1.5, max_tolerance=0.5)
    assert 10 < len(set(expected)) < len(xyz) / 2
    assert adjusted_rand_score(expected, found) == 1.0
    assert (np.diff(np.unique(found, return_index=True)[1]) > 0).all()  # numbered by their first points


def test_spacing_stops_at_the_longest_step():
    far = np.column_stack([np.arange(6) * 0.8, np.zeros(6), np.zeros(6)])
    assert len(set(cluster_by_spacing(far, tolerance=0.1, spacing_factor=9, max_tolerance=0.5))) == 6
    assert len(set(cluster_by_spacing(far, tolerance=0.1, spacing_factor=9, max_tolerance=0.9))) == 1
    with pytest.raises(ParameterError, match="spacing_factor must be at least 0"):
        cluster_by_spacing(far, tolerance=0.5, spacing_factor=-1, max_tolerance=0.1)


def test_a_body_without_a_border_is_not_cut(rng):
    """A long wall has a cut of small value in its middle, but neighbouring cuts are as good."""
    wall = np.column_stack([rng.uniform(0, 20, 20_000), rng.normal(0, 0.01, 20_000), rng.uniform(0, 2, 20_000)])
    cut = NormalizedCutParameters(max_smoothness=1.0)
    assert segment(wall, parameters=cut).max() > 0
    assert segment(wall).max() == 0


def test_dimensions_of_lines_planes_and_volumes(rng):
    line = upright(0, 0, 0, 4)
    side = np.arange(0, 3, 0.08)
    plane = np.stack(np.meshgrid(side + 5, [0.0], side, indexing="ij"), axis=-1).reshape(-1, 3)
    volume = ball(rng, (15, 0, 2), 1.5, 4000)
    kind, direction = classify_dimensions(np.concatenate([line, plane, volume]), (0.2, 0.35, 0.5))
    ends = np.cumsum([len(line), len(plane)])
    one, two, three = np.split(kind, ends)
    assert (one == LINEAR).all()
    assert (two == PLANAR).mean() > 0.9
    assert (three == VOLUMETRIC).mean() > 0.8
    np.testing.assert_allclose(np.abs(direction[: len(line), 2]), 1.0, atol=1e-4)
    inner = np.flatnonzero(two == PLANAR) + ends[0]
    np.testing.assert_allclose(np.abs(direction[inner, 1]), 1.0, atol=1e-4)


def test_yang_dong_takes_a_pole_out_of_a_bush_and_leaves_a_trunk_its_crown(rng):
    pole, bush = upright(0, 0, 0, 6), ball(rng, (0, 0.45, 0.8), 0.7, 3000)
    trunk, crown = upright(20, 0, 0, 3), ball(rng, (20, 0, 4.2), 1.4, 8000)
    truth = np.repeat([0, 1, 2, 2], [len(pole), len(bush), len(trunk), len(crown)])
    found = segment_yang_dong(np.concatenate([pole, bush, trunk, crown]), min_points=10)
    assert adjusted_rand_score(truth, found) > 0.95
    one = cluster_by_spacing(np.concatenate([pole, bush]), tolerance=0.25, spacing_factor=0, max_tolerance=0.25)
    assert one.max() == 0  # nothing but their shapes tells them apart


def scan_of(things, period=0.01):
    """Upright scan lines 0.05 m apart: (x from, x to, y, z from, z to) each; lines alternate between two scanners."""
    rows = []
    for k, x in enumerate(np.arange(0, 6, 0.05)):
        tick = 0
        for low, high, y, bottom, top in things:
            if low <= x < high:
                for z in np.arange(bottom, top, 0.05):
                    rows.append((x, y, z, k * period + tick * 1e-5, k % 2))
                    tick += 1
    return np.array(rows)


def test_two_step_joins_adjacent_runs():
    """A wall of many lines is one object, and a second one 1 m away another."""
    rows = scan_of([(0, 3, 2.0, 0, 2), (4, 6, 2.0, 0, 2)])
    found = segment_two_step(rows[:, :3], gps_time=rows[:, 3], scanner=rows[:, 4].astype(np.uint8))
    np.testing.assert_array_equal(found, rows[:, 0] > 3.5)


def test_two_step_separates_objects_that_touch_at_an_edge():
    """A board whose lowest edge lies beside the top of a wall: clusters join them, runs do not touch enough."""
    # Every line begins far away, so that the top of one does not run on into the bottom of the next.
    rows = scan_of([(0, 6, 9.0, 0, 0.1), (0, 2, 2.0, 0, 3.0), (2, 2.3, 2.0, 2.9, 6.0)])
    columns = {"gps_time": rows[:, 3], "scanner": rows[:, 4].astype(np.uint8)}
    near = rows[:, 1] < 5
    found = segment_two_step(rows[:, :3], **columns)[near]
    assert len(np.unique(found)) == 2
    np.testing.assert_array_equal(found == found[-1], rows[near, 0] >= 1.975)
    joined = segment_two_step(rows[:, :3], **columns, parameters=TwoStepParameters(contact=0.0))[near]
    assert len(np.unique(joined)) == 1
    assert radius_graph_components(rows[near, :3], 0.15).max() == 0


@pytest.mark.parametrize("contact", [0.0, 0.25, 0.8])
def test_touching_runs_equal_brute_force(rng, contact):
    parameters = TwoStepParameters(across=0.2, contact=contact)
    of_run = np.sort(rng.integers(0, 60, 1500))
    places = rng.uniform(0, 2, (60, 3))[of_run] + rng.normal(0, 0.15, (1500, 3)) + [4e5, 5e6, 30]
    near = np.linalg.norm(places[:, None] - places[None], axis=2) <= 0.2
    touches = np.stack([near[:, of_run == run].any(axis=1) for run in range(60)], axis=1)  # place by run
    counts = np.stack([touches[of_run == run].sum(axis=0) for run in range(60)])
    size = np.bincount(of_run, minlength=60)
    good = (counts > 0) & (size[:, None] <= size[None]) & (counts >= contact * size[:, None])
    np.fill_diagonal(good, False)
    found = two_step._touching(places, of_run, parameters)
    assert sorted(map(tuple, found.tolist())) == sorted(map(tuple, np.argwhere(good).tolist()))


def test_two_step_needs_the_order_of_the_scan(rng):
    scene = PointCloud(rng.uniform(0, 1, (50, 3)))
    ground = {"ground": np.zeros(50, dtype=bool)}
    with pytest.raises(MissingColumnError, match="gps_time"):
        segment_scene(scene, ground, SegmentationParameters(method="two_step"))


@pytest.mark.parametrize("method", ["yang_dong", "two_step", "euclidean"])
def test_stage_runs_each_method(rng, method):
    xyz = np.concatenate([ball(rng, (0, 0, 1), 0.5, 900), ball(rng, (5, 0, 1), 0.5, 900), rng.uniform(0, 9, (20, 3))])
    times = {"gps_time": np.arange(len(xyz)) * 1e-5, "scanner": np.zeros(len(xyz), np.uint8)}
    ground = {"ground": np.arange(len(xyz)) >= 1800}
    settings = SegmentationParameters(method=method, two_step={"along": 2.0})
    objects = segment_scene(PointCloud(xyz, times), ground, settings)["objects"]
    assert (objects[1800:] == -1).all()
    assert adjusted_rand_score(np.repeat([0, 1], 900), objects[:1800]) > 0.9


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: YangDongParameters(contact=1.5), "yang_dong.contact"),
        (lambda: YangDongParameters(radii=()), "yang_dong.radii"),
        (lambda: TwoStepParameters(along=0.0), "two_step.along"),
        (lambda: NormalizedCutParameters(max_smoothness=-1.0), "max_smoothness"),
    ],
)
def test_parameters_are_checked(make, name):
    with pytest.raises(ParameterError, match=name):
        make()
