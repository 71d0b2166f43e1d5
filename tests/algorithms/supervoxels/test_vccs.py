"""Supervoxels against a slow re-implementation, planted structures, and what must hold for any cloud."""

import numpy as np
import pytest
from references import vccs as reference
from scipy.sparse.csgraph import connected_components

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.supervoxels.vccs import segment_supervoxels


def partition(labels):
    """Return a labelling as a set of frozensets of points."""
    order = np.argsort(labels, kind="stable")
    return {frozenset(part.tolist()) for part in np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)}


def wavy_street(rng, n=1500):
    """A rough floor, a wall, a thin pole and scattered points: all that makes voxels meet in odd ways."""
    floor = np.c_[rng.uniform(0, 4, (n // 2, 2)), 0.05 * rng.standard_normal(n // 2)]
    wall = np.c_[rng.uniform(0, 4, n // 4), 0.03 * rng.standard_normal(n // 4), rng.uniform(0, 2, n // 4)]
    pole = np.c_[2 + 0.02 * rng.standard_normal((n // 8, 2)), rng.uniform(0, 3, n // 8)]
    return np.concatenate([floor, wall, pole, rng.uniform(-1, 5, (n // 8, 3))])


@pytest.fixture(scope="module")
def street():
    return wavy_street(np.random.default_rng(3))


@pytest.mark.parametrize(("size", "seed"), [(0.2, 0.4), (0.2, 0.6), (0.15, 0.9), (0.3, 0.3)])
def test_equals_the_reference(street, size, seed):
    result = segment_supervoxels(street, voxel_size=size, seed_resolution=seed)
    assert partition(result.labels) == reference.vccs(street, size, seed)


def test_equals_the_reference_with_colour_and_the_printed_distance(street, rng):
    rgb = rng.integers(0, 256, (len(street), 3), dtype=np.uint8)
    result = segment_supervoxels(
        street, rgb=rgb, voxel_size=0.2, seed_resolution=0.6, colour_weight=1.5, distance="tomic"
    )
    assert partition(result.labels) == reference.vccs(street, 0.2, 0.6, (0.4, 1.0, 1.5), rgb, divisor=1.0)


def test_what_holds_for_every_partition(street):
    result = segment_supervoxels(street, voxel_size=0.2, seed_resolution=0.6)
    s = len(result)
    first = np.unique(result.labels, return_index=True)[1]
    assert (np.diff(first) > 0).all() and set(result.labels.tolist()) == set(range(s))
    assert (result.voxel_labels[result.voxel_of_point] == result.labels).all()
    assert result.labels.dtype == np.int32
    indptr, indices = result.grid.neighbors()
    rows = np.repeat(np.arange(len(result.grid)), np.diff(indptr))
    a, b = result.voxel_labels[rows], result.voxel_labels[indices]
    inside = a == b
    same = np.zeros((len(result.grid),) * 2, bool)
    same[rows[inside], indices[inside]] = True
    assert connected_components(same)[0] == s  # every supervoxel is in one piece
    expected = np.zeros((s, s), bool)
    expected[a[~inside], b[~inside]] = True
    assert (result.adjacency.toarray().astype(bool) == expected).all()
    assert (expected == expected.T).all() and not result.adjacency.diagonal().any()
    assert result.adjacency.has_canonical_format
    for k in range(s):
        mine = result.grid.centroids[result.voxel_labels == k]
        np.testing.assert_allclose(result.centroids[k], mine.mean(axis=0), atol=1e-9)


def test_size_is_bound_by_the_levels(rng):
    floor = np.c_[rng.uniform(0, 8, (40_000, 2)), 0.001 * rng.standard_normal(40_000)]
    result = segment_supervoxels(floor, voxel_size=0.1, seed_resolution=0.5)
    coords = result.grid.coords
    reach = int(1.8 * 0.5 / 0.1 + 1e-9) - 1
    for k in range(len(result)):
        assert np.ptp(coords[result.voxel_labels == k], axis=0).max() <= 2 * reach
    assert result.n_islands == 0
    assert 0.7 < len(result) / (8 / 0.5) ** 2 < 1.4
    np.testing.assert_allclose(np.abs(result.normals[:, 2]), 1, atol=1e-2)


def test_a_border_between_planes_is_kept(rng):
    """A floor and a wall meet in an edge: no supervoxel away from the edge's own voxels mixes the two."""
    floor = np.c_[rng.uniform(0.1, 3, 30_000), rng.uniform(0, 3, 30_000), np.zeros(30_000)]
    wall = np.c_[np.zeros(30_000), rng.uniform(0, 3, 30_000), rng.uniform(0.1, 3, 30_000)]
    xyz = np.concatenate([floor, wall])
    truth = np.repeat([0, 1], 30_000)
    result = segment_supervoxels(xyz, voxel_size=0.1, seed_resolution=0.4, spatial_weight=0.1)
    share = np.bincount(result.labels, weights=truth) / np.bincount(result.labels)
    leaked = np.minimum(share, 1 - share) * np.bincount(result.labels)
    assert leaked.sum() / len(xyz) < 0.03
    upright = np.abs(result.normals[:, 2])
    assert (upright[share < 0.02] > 0.9).mean() > 0.9
    assert (upright[share > 0.98] < 0.4).mean() > 0.9


def test_two_boxes_apart_are_two_groups(rng):
    boxes = np.concatenate([rng.uniform(0, 0.5, (500, 3)), rng.uniform(0, 0.5, (500, 3)) + np.array([2, 0, 0])])
    result = segment_supervoxels(boxes, voxel_size=0.25, seed_resolution=2.0)
    assert partition(result.labels) == {frozenset(range(500)), frozenset(range(500, 1000))}
    assert result.adjacency.nnz == 0


def test_colour_quadrants_are_cut_exactly():
    """Four colours on a plane, one point a voxel: with colour alone the quadrants are never mixed."""
    x, y = np.meshgrid(np.arange(24), np.arange(24), indexing="ij")
    xyz = np.c_[x.ravel(), y.ravel(), np.zeros(x.size)] * 0.1 + 0.05
    quadrant = (x.ravel() >= 12) * 2 + (y.ravel() >= 12)
    rgb = np.array([[250, 0, 0], [0, 250, 0], [0, 0, 250], [250, 250, 250]], np.uint8)[quadrant]
    cut = segment_supervoxels(
        xyz, rgb=rgb, voxel_size=0.1, seed_resolution=0.4, colour_weight=1.0, spatial_weight=0.01, normal_weight=0.01
    )
    assert all(len(set(quadrant[list(part)])) == 1 for part in partition(cut.labels))
    plain = segment_supervoxels(xyz, voxel_size=0.1, seed_resolution=0.4)
    assert not all(len(set(quadrant[list(part)])) == 1 for part in partition(plain.labels))


def test_given_normals_replace_the_fitted_ones_whatever_their_sign(street, rng):
    up = np.tile([0.0, 0.0, 1.0], (len(street), 1))
    flipped = up * rng.choice([-2.0, 3.0], (len(street), 1))
    a = segment_supervoxels(street, normals=up, voxel_size=0.2, seed_resolution=0.6)
    b = segment_supervoxels(street, normals=flipped, voxel_size=0.2, seed_resolution=0.6)
    assert (a.labels == b.labels).all()
    np.testing.assert_allclose(a.normals, np.tile([0.0, 0.0, 1.0], (len(a), 1)), atol=1e-12)
    none = segment_supervoxels(street, normals=up * np.nan, voxel_size=0.2, seed_resolution=0.6)
    assert np.isnan(none.normals).all()


def test_order_of_the_points_does_not_matter(street, rng):
    shuffle = rng.permutation(len(street))
    a = segment_supervoxels(street, voxel_size=0.2, seed_resolution=0.6)
    b = segment_supervoxels(street[shuffle], voxel_size=0.2, seed_resolution=0.6)
    assert (a.voxel_labels.shape == b.voxel_labels.shape) and (a.grid.local_centroids == b.grid.local_centroids).all()
    relabel = np.full(len(a), -1)
    relabel[b.labels] = a.labels[shuffle]
    assert (relabel[b.labels] == a.labels[shuffle]).all() and len(np.unique(relabel)) == len(a)
    assert (b.centroids == a.centroids[relabel]).all()


@pytest.mark.parametrize("offset", [(491_234.567, 5_456_789.123, 251.9), (-1e5, 0.0, 1e3)])
def test_place_on_earth_does_not_matter(street, offset):
    a = segment_supervoxels(street, voxel_size=0.2, seed_resolution=0.6)
    b = segment_supervoxels(street + offset, voxel_size=0.2, seed_resolution=0.6)
    assert (a.labels == b.labels).all()
    np.testing.assert_allclose(b.centroids - offset, a.centroids, atol=1e-6)


def test_threads_and_runs_give_the_same_bytes(street, rng):
    rgb = rng.integers(0, 256, (len(street), 3), dtype=np.uint8)
    before = street.copy(), rgb.copy()
    runs = [
        segment_supervoxels(street, rgb=rgb, voxel_size=0.2, seed_resolution=0.6, n_refinements=1, n_threads=n)
        for n in (1, 1, 2, 3)
    ]
    for other in runs[1:]:
        for name in ("labels", "centroids", "normals", "voxel_labels"):
            assert getattr(other, name).tobytes() == getattr(runs[0], name).tobytes()
        assert (other.adjacency != runs[0].adjacency).nnz == 0
    assert (before[0] == street).all() and (before[1] == rgb).all()


def test_refinement_keeps_the_partition_whole(street):
    result = segment_supervoxels(street, voxel_size=0.2, seed_resolution=0.6, n_refinements=2)
    assert set(result.labels.tolist()) == set(range(len(result)))
    assert np.bincount(result.labels).min() > 0


def test_float32_columns_and_lists_are_read(street):
    single = street.astype(np.float32)
    a = segment_supervoxels(single, voxel_size=0.2, seed_resolution=0.6)
    b = segment_supervoxels(np.asfortranarray(single.astype(np.float64)), voxel_size=0.2, seed_resolution=0.6)
    assert (a.labels == b.labels).all()
    assert segment_supervoxels([[0, 0, 0], [9, 9, 9]], voxel_size=1, seed_resolution=2).labels.tolist() == [0, 1]


@pytest.mark.parametrize("n", [1, 40])
def test_one_place_is_one_supervoxel_without_normal(n):
    result = segment_supervoxels(np.full((n, 3), 7.25), voxel_size=0.1, seed_resolution=0.3)
    assert result.labels.tolist() == [0] * n
    assert result.adjacency.shape == (1, 1) and result.adjacency.nnz == 0
    np.testing.assert_allclose(result.centroids, [[7.25] * 3])
    assert np.isnan(result.normals).all()


def test_a_straight_line_has_no_normal_but_is_cut():
    line = np.c_[np.arange(50) * 0.1 + 0.05, np.zeros((50, 2))]
    result = segment_supervoxels(line, voxel_size=0.1, seed_resolution=0.5)
    assert np.isnan(result.normals).all()
    assert 5 <= len(result) <= 15
    assert (np.diff(result.labels) >= 0).all()


def test_islands_keep_their_points_and_are_counted(rng):
    """At 10 voxels a seed needs four voxels around it: two far single points have none."""
    floor = np.c_[rng.uniform(0, 4, (20_000, 2)), np.zeros(20_000)]
    xyz = np.concatenate([floor, [[20.0, 0, 0], [20.03, 0, 0], [0, 30.0, 5.0]]])
    result = segment_supervoxels(xyz, voxel_size=0.1, seed_resolution=1.0)
    assert result.n_islands == 2
    assert result.labels[-3] == result.labels[-2] != result.labels[-1]
    assert (result.labels[-3:] > result.labels[:-3].max()).all()


SIZES = {"voxel_size": 0.2, "seed_resolution": 0.6}


@pytest.mark.parametrize(
    ("xyz", "keywords", "error", "message"),
    [
        (np.empty((0, 3)), {}, DataError, "at least 1 points, got 0"),
        (np.zeros((4, 2)), {}, DataError, r"shape \(n, 3\), got \(4, 2\)"),
        (np.array([[0, 0, 0], [0, np.nan, 0]]), {}, DataError, "1 points with NaN or infinite .* row 1"),
        (np.array([[np.inf, 0, 0]]), {}, DataError, "NaN or infinite"),
        (np.zeros((2, 3)), {"rgb": np.zeros((3, 3), np.uint8)}, DataError, r"rgb must have shape \(2, 3\)"),
        (np.zeros((2, 3)), {"rgb": np.zeros((2, 3))}, DataError, "rgb must be uint8, got float64"),
        (np.zeros((2, 3)), {"normals": np.zeros((2, 2))}, DataError, r"normals must have shape \(2, 3\)"),
        (np.zeros((2, 3)), {"voxel_size": 0.0}, ParameterError, "voxel_size must be a finite number > 0, got 0.0"),
        (np.zeros((2, 3)), {"seed_resolution": np.nan}, ParameterError, "seed_resolution .* got nan"),
        (np.zeros((2, 3)), {"seed_resolution": 0.1}, ParameterError, "seed_resolution 0.1 must not be less"),
        (np.zeros((2, 3)), {"colour_weight": -1.0}, ParameterError, "colour_weight must be .* got -1.0"),
        (np.zeros((2, 3)), {"spatial_weight": np.inf}, ParameterError, "spatial_weight must be .* got inf"),
        (
            np.zeros((2, 3)),
            {"colour_weight": 0, "spatial_weight": 0, "normal_weight": 0},
            ParameterError,
            "must not all be 0",
        ),
        (np.zeros((2, 3)), {"distance": "euclid"}, ParameterError, "distance must be one of .* got 'euclid'"),
        (np.zeros((2, 3)), {"n_refinements": -1}, ParameterError, "n_refinements must be .* got -1"),
        (np.zeros((2, 3)), {"n_threads": 0}, ParameterError, "n_threads must be .* got 0"),
        (np.array([[0.0] * 3, [1e9] * 3]), {}, ParameterError, "voxel_size 0.2 is too small for a cloud 1e[+]09 m"),
    ],
)
def test_bad_input_is_named(xyz, keywords, error, message):
    with pytest.raises(error, match=message):
        segment_supervoxels(xyz, **{**SIZES, **keywords})


@pytest.mark.real_data
def test_oakland_block(real_data):
    folder = real_data("oakland")
    path = sorted(folder.glob("*.gz"))[0]
    xyz = np.loadtxt(path, usecols=(0, 1, 2), comments="#")[:30_000]
    result = segment_supervoxels(xyz, voxel_size=0.2, seed_resolution=0.6)
    assert len(result.labels) == len(xyz) and np.bincount(result.labels).min() > 0
    assert 5 < len(xyz) / len(result) < 200
