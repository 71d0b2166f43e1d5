"""Normalised cuts against the exact eigenvector, all splits of tiny graphs, and planted objects."""

from itertools import product

import numpy as np
import pytest
import scipy.linalg
from sklearn.metrics import adjusted_rand_score

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.geometry.voxels.grid import build_voxel_grid
from mlsroad_pipeline.algorithms.segmentation.bisection import best_split, gather, node_weights, second_eigenvector
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import NormalizedCutParameters, segment, smooth_intensities

SCALE = np.array([1 / 4, 1 / 100, 1.0])


def tree(rng, x, y, n=6000, radius=1.6, height=5.0):
    """A ball of leaves on a trunk."""
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    crown = direction * radius * rng.random((n, 1)) ** (1 / 3) + [x, y, height]
    trunk = rng.uniform([x - 0.1, y - 0.1, 0], [x + 0.1, y + 0.1, height - radius], (n // 8, 3))
    return np.concatenate([crown, trunk])


def weights_by_hand(places, mass, sigma=(2.0, 10.0, 1.0), reach=5.0):
    """Equation 19, pair by pair."""
    out = np.zeros((len(places), len(places)))
    for i, j in product(range(len(places)), repeat=2):
        flat = np.hypot(*(places[i, :2] - places[j, :2]))
        exponent = (flat / sigma[0]) ** 2
        exponent += ((places[i, 2] - places[j, 2]) / sigma[1]) ** 2 + ((places[i, 3] - places[j, 3]) / sigma[2]) ** 2
        out[i, j] = mass[i] * mass[j] * np.exp(-exponent) if flat <= reach else 0.0
    return out


def test_weights_are_equation_19(rng):
    places = np.column_stack([rng.uniform(0, 7, (30, 3)), rng.random(30)])
    mass = rng.integers(1, 9, 30).astype(np.float64)
    np.testing.assert_allclose(node_weights(places, mass, SCALE, 25.0), weights_by_hand(places, mass), atol=1e-12)


@pytest.mark.parametrize("n", [3, 12, 150])
def test_second_eigenvector_is_the_exact_one(n, rng):
    places = np.column_stack([rng.uniform(0, 6, (n, 3)), rng.random(n)])
    weights = weights_by_hand(places, np.ones(n))
    degree = weights.sum(axis=1)
    y, eigenvalue = second_eigenvector(weights, degree, places[:, 0] - places[:, 0].mean())
    values, vectors = scipy.linalg.eigh(weights, np.diag(degree))
    assert eigenvalue == pytest.approx(values[-2], abs=1e-8)
    cosine = abs(y @ vectors[:, -2]) / np.linalg.norm(y) / np.linalg.norm(vectors[:, -2])
    assert cosine > 1 - 1e-6
    # A start parallel to the first eigenvector is replaced.
    assert second_eigenvector(weights, degree, np.ones(n))[1] == pytest.approx(values[-2], abs=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_split_is_the_best_of_all_along_the_eigenvector_and_near_the_best_of_all(seed):
    rng = np.random.default_rng(seed)
    places = np.column_stack(
        [np.concatenate([rng.normal(0, 0.5, (5, 3)), rng.normal(2.5, 0.5, (6, 3))]), rng.random(11)]
    )
    weights = weights_by_hand(places, np.ones(11))
    degree = weights.sum(axis=1)

    def ncut(side):
        cut = weights[np.ix_(side, ~side)].sum()
        return cut / degree[side].sum() + cut / degree[~side].sum()

    y, _ = second_eigenvector(weights, degree, places[:, 0])
    threshold, value = best_split(weights, degree, np.ones(11), y, 1.0)
    assert value == pytest.approx(ncut(y <= threshold))
    assert value == pytest.approx(min(ncut(y <= t) for t in np.sort(y)[:-1]))
    every = [np.array(side) for side in product([False, True], repeat=11) if 0 < sum(side) < 11]
    assert value <= min(map(ncut, every)) * 1.05


def test_gathered_nodes_keep_mass_and_centre(rng):
    places = np.column_stack([rng.uniform(0, 4, (3000, 3)), rng.random(3000)])
    nodes, mass = gather(places, np.arange(3000), 0.1, 200)
    assert 50 < len(nodes) <= 200 and mass.sum() == 3000
    np.testing.assert_allclose((nodes * mass[:, None]).sum(axis=0), places.sum(axis=0))


def test_coarse_graph_finds_the_cut_of_the_fine_one(rng):
    points = np.concatenate([tree(rng, 0, 0, 500), tree(rng, 2.9, 0.4, 500)])
    fine = segment(points, parameters=NormalizedCutParameters(tolerance=0.6, max_nodes=2000))
    coarse = segment(points, parameters=NormalizedCutParameters(tolerance=0.6, max_nodes=60))
    assert fine.max() == coarse.max() == 1
    assert (fine != coarse).mean() < 0.02


def test_touching_trees_are_cut_and_a_single_one_is_not(rng):
    parts = [tree(rng, 0, 0), tree(rng, 3.0, 0), tree(rng, 30, 0)]
    truth = np.repeat(np.arange(3), [len(part) for part in parts])
    points = np.concatenate(parts)
    wide = NormalizedCutParameters(tolerance=0.3)
    assert cluster(points, tolerance=0.3).max() == 1  # the two touch
    found = segment(points, parameters=wide)
    assert found.max() == 2 and adjusted_rand_score(truth, found) > 0.97


def test_intensity_separates_a_pole_from_the_bush_around_it(rng):
    pole = rng.uniform([-0.08, -0.08, 0], [0.08, 0.08, 4], (4000, 3))
    bush = rng.uniform([-0.5, -0.5, 0], [0.5, 0.5, 1.5], (8000, 3))
    points = np.concatenate([pole, bush[np.abs(bush[:, :2]).max(axis=1) > 0.08]])
    truth = np.arange(len(points)) >= 4000
    intensity = np.where(truth, 0.15, 0.9)
    parameters = NormalizedCutParameters(
        sigma_i=0.2,
        smoothing=0,
        tall_smoothing=0,
        max_nodes=2000,
        pole_length=0,  # by its shape it would be found without
    )
    with_it = segment(points, intensity=intensity, parameters=parameters)
    without = segment(points, parameters=parameters)
    assert adjusted_rand_score(truth, with_it) > 0.9
    assert adjusted_rand_score(truth, without) < 0.6


def test_intensities_are_means_over_cells_and_their_neighbours(rng):
    places = np.column_stack([rng.uniform(0, 2, (400, 3)), rng.random(400)])
    clusters = rng.integers(0, 2, 400).astype(np.int32)
    found = smooth_intensities(places, clusters, size=0.3)[:, 3]
    cell = np.floor((places[:, :3] - places[:, :3].min(axis=0)) / 0.3)
    for k in range(400):
        near = (np.abs(cell - cell[k]).max(axis=1) <= 1) & (clusters == clusters[k])
        assert found[k] == pytest.approx(places[near, 3].mean())


def test_noisy_intensities_part_a_body_that_has_no_border(rng):
    body = rng.uniform([0, 0, 0], [6, 1.2, 1.2], (20_000, 3))
    truth = body[:, 0] > 3
    intensity = np.clip(np.where(truth, 0.65, 0.35) + rng.normal(0, 0.1, len(body)), 0, 1)
    with_it, without = segment(body, intensity=intensity), segment(body)
    assert adjusted_rand_score(truth, with_it) > 0.95
    assert without.max() == 0
    assert segment(body, intensity=rng.normal(0.5, 0.1, len(body)).clip(0, 1)).max() == 0


def car(rng, x, y, n=6000):
    """Flanks, bonnet, boot and cabin of a car that points along y."""
    low = rng.uniform([-0.9, -2.2, 0.3], [0.9, 2.2, 0.9], (n, 3))
    flank = rng.random(n) < 0.3
    low[flank, 0], low[~flank, 2] = np.sign(low[flank, 0]) * 0.9, 0.9
    cabin = rng.uniform([-0.7, -1.2, 0.9], [0.7, 1.2, 1.5], (n // 2, 3))
    cabin[:, 2] = np.where(rng.random(n // 2) < 0.7, 1.5, cabin[:, 2])
    return np.concatenate([low, cabin]) + [x, y, 0]


def test_cars_side_by_side_are_two_and_one_is_one(rng):
    one, other = car(rng, 0, 0), car(rng, 2.5, 1.0)
    between = rng.uniform([0.85, 0, 0.3], [1.65, 0.3, 0.5], (600, 3))  # what both touch
    points, truth = np.concatenate([one, other, between]), np.repeat([0, 1], len(one))
    assert segment(one).max() == 0
    found = segment(points)
    assert found.max() == 1 and adjusted_rand_score(truth, found[: len(truth)]) > 0.9
    assert segment(points, parameters=NormalizedCutParameters(low_height=0)).max() == 0


def test_weakly_connected_cars_are_cut_at_the_smallest_scale(rng):
    """At 1 m edges of two adjacent cars reach across the gap; at 0.5 m a bar between them has little weight."""
    one, other = car(rng, 0, 0), car(rng, 2.4, 0.3)
    bar = rng.uniform([0.85, 0.2, 0.4], [1.55, 0.4, 0.6], (400, 3))
    points, truth = np.concatenate([one, other, bar]), np.repeat([0, 1], len(one))
    assert adjusted_rand_score(truth, segment(points)[: len(truth)]) > 0.95
    once = NormalizedCutParameters(low_sigma_h=(1.0,), low_max_cut=(0.14,))
    assert segment(points, parameters=once).max() == 0
    with pytest.raises(ParameterError, match="must have the same number of values, got 2 and 1"):
        NormalizedCutParameters(low_max_cut=(0.1,))


def test_no_part_is_small_and_parts_stay_within_their_clusters(rng):
    points = np.concatenate([tree(rng, 0, 0), tree(rng, 3.0, 0), rng.uniform(10, 10.3, (50, 3))])
    parameters = NormalizedCutParameters(tolerance=0.3, spacing_factor=0, max_cut=1.2, min_voxels=40)
    found, clusters = segment(points, parameters=parameters), cluster(points, tolerance=0.3)
    voxels = build_voxel_grid(points, voxel_size=0.1).voxel_of_point
    for part in np.unique(found):
        assert len(np.unique(clusters[found == part])) == 1
        assert (
            len(np.unique(voxels[found == part])) >= 40
            or (clusters == clusters[found == part][0]).sum() == (found == part).sum()
        )
    assert (found >= 0).all()
    few = segment(points, parameters=parameters, min_points=60)
    np.testing.assert_array_equal(few == -1, np.bincount(found)[found] < 60)
    assert (few[-50:] == -1).all()


def test_a_cluster_of_many_voxels_needs_no_square_of_them(rng):
    wall = np.column_stack([rng.uniform(0, 120, 300_000), rng.normal(0, 0.01, 300_000), rng.uniform(0, 6, 300_000)])
    found = segment(
        wall, parameters=NormalizedCutParameters(max_smoothness=1.0)
    )  # 72,000 voxels in one cluster: their graph would have 250 million edges
    assert (found >= 0).all() and len(np.unique(found)) > 10


def test_nothing_in_nothing_out():
    assert segment(np.zeros((0, 3))).shape == (0,)
    assert segment([[1.0, 2.0, 3.0]]).tolist() == [0]
    assert segment(np.zeros((50, 3)), intensity=np.full(50, 0.5)).tolist() == [0] * 50


def test_bad_input():
    with pytest.raises(DataError, match=r"intensity at row 1 is 7\.0: it must be normalised"):
        segment(np.zeros((2, 3)), intensity=[0.5, 7.0])
    with pytest.raises(DataError, match="intensity at row 0 is nan"):
        segment(np.zeros((1, 3)), intensity=[np.nan])
    with pytest.raises(ParameterError, match=r"max_cut .*got 3"):
        NormalizedCutParameters(max_cut=3)
    with pytest.raises(ParameterError, match=r"low_max_cut .*got -1"):
        NormalizedCutParameters(low_max_cut=-1)
    with pytest.raises(ParameterError, match=r"smoothing .*got -0\.1"):
        NormalizedCutParameters(smoothing=-0.1)
    with pytest.raises(ParameterError, match=r"max_nodes .*got 2"):
        NormalizedCutParameters(max_nodes=2)
    with pytest.raises(ParameterError, match="sigma_h must be"):
        NormalizedCutParameters(sigma_h=0)
    with pytest.raises(ParameterError, match=r"min_points .*got 0"):
        segment(np.zeros((2, 3)), min_points=0)
