"""Euclidean clusters against SciPy's components of the radius graph."""

import numpy as np
import pandas as pd
import pytest
from references.inventory import radius_graph_components, renumber_by_first

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster

UTM = np.array([583_000.0, 4_477_000.0, 120.0])


def clumps(rng, n=1500):
    """Points on lines and sheets with gaps: many clusters at any tolerance."""
    centres = rng.uniform(0, 6, (40, 3))
    directions = rng.normal(size=(40, 3))
    pick = rng.integers(0, 40, n)
    return centres[pick] + directions[pick] * rng.uniform(0, 0.5, (n, 1)) + rng.normal(0, 0.02, (n, 3))


@pytest.mark.parametrize("tolerance", [0.02, 0.1, 0.3, 1.0, 50.0])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_equals_scipy_components(rng, tolerance, dtype):
    xyz = clumps(rng).astype(dtype)
    labels = cluster(xyz, tolerance=tolerance)
    assert labels.dtype == np.int32
    np.testing.assert_array_equal(labels, radius_graph_components(xyz, tolerance))


@pytest.mark.parametrize("min_points", [2, 10, 5000])
def test_small_clusters_are_minus_one(rng, min_points):
    xyz = clumps(rng)
    expected = radius_graph_components(xyz, 0.1, min_points)
    np.testing.assert_array_equal(cluster(xyz, tolerance=0.1, min_points=min_points), expected)


def test_equals_scipy_at_utm_coordinates(rng):
    xyz = np.round(clumps(rng), 3) + UTM
    np.testing.assert_array_equal(cluster(xyz, tolerance=0.1), radius_graph_components(xyz, 0.1))


def test_the_tolerance_itself_joins():
    line = np.column_stack([np.arange(6) * 0.5, np.zeros(6), np.zeros(6)])
    assert cluster(line, tolerance=0.5).tolist() == [0] * 6
    assert cluster(line, tolerance=np.nextafter(0.5, 0)).tolist() == list(range(6))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_ends_of_a_long_cloud_do_not_touch(axis):
    """Cell numbers wrap from one row into the next; points must not."""
    xyz = np.zeros((4, 3))
    xyz[:, axis] = [0.0, 10.0, 0.01, 9.99]
    xyz[2:, (axis + 1) % 3] = 0.1
    assert cluster(xyz, tolerance=0.15).tolist() == [0, 1, 0, 1]


def test_lattice_of_every_offset(rng):
    """A pair at each direction and distance around the tolerance covers each neighbouring cell."""
    directions = rng.normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    for factor, joined in [(0.999999, True), (1.000001, False)]:
        for direction in directions[:100]:
            pair = np.array([[0, 0, 0], direction * 0.2 * factor]) + rng.uniform(-1, 1, 3)
            assert (cluster(pair, tolerance=0.2)[1] == 0) == joined


def test_permutation_changes_only_the_numbering(rng):
    xyz = clumps(rng)
    order = rng.permutation(len(xyz))
    np.testing.assert_array_equal(
        cluster(xyz[order], tolerance=0.1), renumber_by_first(cluster(xyz, tolerance=0.1)[order])
    )


def test_input_is_not_modified_and_result_repeats(rng):
    xyz = clumps(rng)
    before = xyz.copy()
    first = cluster(xyz, tolerance=0.1)
    assert first.tobytes() == cluster(xyz, tolerance=0.1).tobytes()
    np.testing.assert_array_equal(xyz, before)


def test_duplicates_and_small_inputs():
    assert cluster(np.zeros((0, 3)), tolerance=0.1).tolist() == []
    assert cluster([[1.0, 2.0, 3.0]], tolerance=0.1).tolist() == [0]
    assert cluster([[1.0, 2.0, 3.0]], tolerance=0.1, min_points=2).tolist() == [-1]
    assert cluster(np.ones((50, 3)), tolerance=1e-6).tolist() == [0] * 50


def test_oakland_block_equals_scipy(real_data):
    path = sorted(real_data("oakland").glob("*.gz"))[0]
    xyz = pd.read_csv(path, sep=r"\s+", comment="#", header=None, nrows=30_000).to_numpy()[:, :3]
    np.testing.assert_array_equal(cluster(xyz, tolerance=0.2), radius_graph_components(xyz, 0.2))


@pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan, np.inf])
def test_tolerance_must_be_positive(tolerance):
    with pytest.raises(ParameterError, match="tolerance must be a finite number > 0"):
        cluster(np.zeros((2, 3)), tolerance=tolerance)


def test_bad_input_is_named():
    with pytest.raises(ParameterError, match=r"min_points .*got 0"):
        cluster(np.zeros((2, 3)), tolerance=0.1, min_points=0)
    with pytest.raises(DataError, match="first at row 1"):
        cluster([[0.0, 0, 0], [np.nan, 0, 0]], tolerance=0.1)
    with pytest.raises(DataError, match=r"too many cells for a tolerance of 0\.0001"):
        cluster([[0.0, 0, 0], [1e9, 1e9, 1e9]], tolerance=1e-4)
    with pytest.raises(DataError, match=r"shape \(n, 3\)"):
        cluster(np.zeros((4, 2)), tolerance=0.1)
