"""Labels of points and supervoxels against SciPy and hand-counted cases."""

import numpy as np
import pytest
from references.accuracy import smoothed
from references.forest import voxel_partition
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.papers.tomic2019.detrended_forest.labeller import (
    label_points,
    nearest_supervoxels,
    smooth_probabilities,
)


@pytest.mark.parametrize("offset", [0.0, np.array([451_234.0, 5_412_987.0, 312.0])])
def test_the_nearest_supervoxel_is_scipys(rng, offset):
    xyz = rng.random((3000, 3)) * [8, 6, 2] + offset
    xyz = np.vstack([xyz, offset + np.array([[900.0, -700.0, 50.0]])])  # an outlier far from all centroids
    centroids = rng.random((150, 3)) * [8, 6, 2] + offset
    got = nearest_supervoxels(xyz, centroids)
    assert got.dtype == np.int32
    assert np.array_equal(got, cKDTree(centroids).query(xyz)[1])
    assert np.array_equal(got, nearest_supervoxels(xyz, centroids, n_threads=2))


def test_of_equally_near_supervoxels_the_lowest_is_taken():
    centroids = np.array([[2.0, 0, 0], [0, 0, 0], [0, 0, 0]])
    assert nearest_supervoxels([[1.0, 0, 0], [0.2, 0, 0]], centroids).tolist() == [0, 1]
    assert nearest_supervoxels([[5.0, 0, 0]], [[1.0, 1, 1]]).tolist() == [0]
    assert nearest_supervoxels(np.empty((0, 3)), centroids).tolist() == []


def test_points_take_the_most_probable_class_and_its_probability(rng):
    xyz = rng.random((500, 3)).astype(np.float32) * 3
    owners, _ = voxel_partition(xyz, 0.7)
    centroids = np.stack([xyz[owners == s].mean(axis=0) for s in range(owners.max() + 1)])
    probabilities = rng.dirichlet(np.ones(4), len(centroids)).astype(np.float32)
    nearest = cKDTree(centroids).query(xyz)[1]
    assert (nearest != owners).any()  # so that the two rules differ
    for rule, expected in (("nearest", nearest), ("own", owners)):
        labels, confidence = label_points(xyz, centroids, probabilities, rule=rule, supervoxel_labels=owners)
        assert (labels.dtype, confidence.dtype) == (np.int16, np.float32)
        assert np.array_equal(labels, probabilities[expected].argmax(axis=1))
        assert np.array_equal(confidence, probabilities[expected].max(axis=1))
    order = rng.permutation(len(xyz))
    shuffled = label_points(xyz[order], centroids, probabilities)
    straight = label_points(xyz, centroids, probabilities)
    assert all(np.array_equal(a, b[order]) for a, b in zip(shuffled, straight, strict=True))


def test_bad_input_is_named(rng):
    xyz, centroids, probabilities = rng.random((5, 3)), rng.random((2, 3)), np.full((2, 3), 1 / 3)
    with pytest.raises(ParameterError, match=r"rule .*got 'far'"):
        label_points(xyz, centroids, probabilities, rule="far")
    with pytest.raises(DataError, match="rule 'own' needs supervoxel_labels"):
        label_points(xyz, centroids, probabilities, rule="own")
    with pytest.raises(DataError, match=r"supervoxel_labels .*got 0\.\.2"):
        label_points(xyz, centroids, probabilities, rule="own", supervoxel_labels=[0, 1, 2, 0, 0])
    with pytest.raises(DataError, match=r"supervoxel_labels must have shape \(5,\)"):
        label_points(xyz, centroids, probabilities, rule="own", supervoxel_labels=[0])
    with pytest.raises(DataError, match=r"probabilities .*got \(3, 3\)"):
        label_points(xyz, centroids, np.eye(3))
    with pytest.raises(DataError, match="probabilities must be finite"):
        label_points(xyz, centroids, probabilities * np.nan)
    with pytest.raises(DataError, match=r"centroids .*got 0"):
        label_points(xyz, np.empty((0, 3)), np.empty((0, 3)))
    with pytest.raises(DataError, match="NaN or infinite coordinates, the first at row 4"):
        label_points(np.vstack([xyz[:4], [[0, np.nan, 0]]]), centroids, probabilities)
    with pytest.raises(ParameterError, match="n_threads must be at least 1"):
        label_points(xyz, centroids, probabilities, n_threads=0)


def test_probabilities_are_smoothed_over_neighbours(rng):
    dense = np.triu(rng.random((40, 40)) < 0.1, 1)
    dense[9] = dense[:, 9] = False  # a supervoxel without neighbours
    adjacency = csr_array((dense | dense.T).astype(np.int8))
    probabilities = rng.dirichlet(np.ones(5), 40).astype(np.float32)
    before = probabilities.copy()
    got = smooth_probabilities(probabilities, adjacency, weight=0.3)
    assert got.dtype == np.float32
    assert np.allclose(got, smoothed(probabilities, adjacency, 0.3), atol=1e-6)
    assert np.allclose(got.sum(axis=1), 1, atol=1e-6)
    assert np.array_equal(got[9], probabilities[9])
    assert np.array_equal(smooth_probabilities(probabilities, adjacency, weight=0), before)
    assert np.array_equal(probabilities, before)


def test_smoothing_names_bad_input():
    probabilities = np.eye(3, dtype=np.float32)
    with pytest.raises(ParameterError, match=r"weight .*got 1.5"):
        smooth_probabilities(probabilities, csr_array((3, 3)), weight=1.5)
    with pytest.raises(DataError, match=r"adjacency .*got \(2, 2\)"):
        smooth_probabilities(probabilities, csr_array((2, 2)), weight=0.5)
