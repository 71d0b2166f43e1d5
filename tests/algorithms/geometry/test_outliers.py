import numpy as np
import pytest
from references import ground as references

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.geometry.outliers import keep_inliers


@pytest.fixture
def cloud(rng):
    """A dense sheet and 30 strays far from it."""
    sheet = rng.uniform(0, 10, (2000, 3)) * [1, 1, 0.01]
    return np.concatenate([sheet, rng.uniform(-60, 60, (30, 3)) + np.array([0, 0, 100])])


@pytest.mark.parametrize(("n_neighbors", "std_ratio"), [(2, 1.0), (8, 0.5), (20, 2.0)])
def test_equals_open3d_and_the_oracle(cloud, n_neighbors, std_ratio):
    import open3d

    kept = keep_inliers(cloud, n_neighbors=n_neighbors, std_ratio=std_ratio)
    legacy = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(cloud))
    _, index = legacy.remove_statistical_outlier(n_neighbors, std_ratio)
    np.testing.assert_array_equal(np.flatnonzero(kept), np.sort(index))
    np.testing.assert_array_equal(kept, references.keep_inliers(cloud, n_neighbors, std_ratio))


def test_strays_go_and_the_sheet_stays(cloud):
    kept = keep_inliers(cloud, n_neighbors=5)
    assert kept[:2000].all()
    assert not kept[2000:].any()


def test_piles_of_coinciding_points_stay(rng):
    pile = np.zeros((30, 3))
    spread = rng.uniform(1, 3, (300, 3))
    assert keep_inliers(np.concatenate([pile, spread]), n_neighbors=5)[:30].all()


def test_invariances(cloud, rng):
    before = cloud.copy()
    kept = keep_inliers(cloud)
    np.testing.assert_array_equal(cloud, before)
    order = rng.permutation(len(cloud))
    np.testing.assert_array_equal(keep_inliers(cloud[order]), kept[order])
    np.testing.assert_array_equal(keep_inliers(cloud + np.array([458_000.0, 5_428_000.0, 100.0])), kept)


def test_few_points():
    assert keep_inliers(np.empty((0, 3))).shape == (0,)
    assert keep_inliers([[1.0, 2.0, 3.0]]).tolist() == [True]
    assert keep_inliers([[0, 0, 0], [1, 0, 0]]).all()


@pytest.mark.parametrize(
    ("parameters", "message"),
    [({"n_neighbors": 1}, "n_neighbors must be at least 2, got 1"), ({"std_ratio": 0.0}, "std_ratio must be")],
)
def test_bad_parameters_are_named(parameters, message):
    with pytest.raises(ParameterError, match=message):
        keep_inliers(np.zeros((3, 3)), **parameters)


def test_bad_points_are_named():
    with pytest.raises(DataError, match="NaN or infinite"):
        keep_inliers([[0, 0, np.nan]])
    with pytest.raises(DataError, match=r"shape \(n, 3\)"):
        keep_inliers(np.zeros((3, 2)))
