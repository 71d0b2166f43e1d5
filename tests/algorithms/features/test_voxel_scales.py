import numpy as np
import pytest
from references.voxel_scales import Voxels

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.features.voxel_scales import compute_voxel_features, rank_within, smooth_by_cells
from mlsroad_pipeline.algorithms.features.voxel_table import intensity_columns, voxel_feature_names


@pytest.fixture(scope="module")
def street():
    """A rough road, a facade, a crown over a trunk and a wire; heights with gaps."""
    rng = np.random.default_rng(0)
    road = rng.uniform([0, 0, 0], [9, 6, 0.1], (150, 3))
    facade = rng.uniform([0, 5.8, 0], [9, 6, 7], (150, 3))
    crown = np.concatenate(
        [rng.normal([3, 2, 4], 0.7, (80, 3)), rng.uniform([2.95, 1.95, 0], [3.05, 2.05, 3], (40, 3))]
    )
    wire = np.column_stack([np.linspace(0, 9, 30), np.full(30, 3.0), np.full(30, 9.5)]) + rng.normal(0, 0.03, (30, 3))
    xyz = np.concatenate([road, facade, crown, wire]) + [431.07, -76.3, 12.9]
    height = np.maximum(xyz[:, 2] - 12.95, 0).astype(np.float32)
    height[::17] = np.nan
    intensity = rng.integers(0, 40, len(xyz)).astype(np.float32) / 40
    return xyz, height, intensity


@pytest.mark.parametrize("with_intensity", [True, False])
def test_table_equals_the_slow_reference(street, with_intensity):
    xyz, height, intensity = street
    intensity = intensity if with_intensity else None
    features = compute_voxel_features(xyz, height=height, intensity=intensity)
    slow = Voxels(xyz, height, intensity)
    assert [tuple(row) for row in features.cells.index.tolist()] == slow.names
    for number, voxel in enumerate(slow.names):
        np.testing.assert_array_equal(np.flatnonzero(features.owner == number), slow.points[voxel])
    rows = range(0, len(slow.names), 7)
    expected = [slow.describe(slow.names[row]) for row in rows]
    assert set(expected[0]) == set(voxel_feature_names())
    table = np.array([[line[name] for name in voxel_feature_names()] for line in expected])
    np.testing.assert_allclose(features.values[rows], table, rtol=2e-5, atol=2e-5)
    assert features.values.dtype == np.float32


def test_neither_order_nor_threads_nor_place_change_the_table(street):
    xyz, height, intensity = street
    whole = compute_voxel_features(xyz, height=height, intensity=intensity)
    order = np.random.default_rng(1).permutation(len(xyz))
    other = compute_voxel_features(xyz[order], height=height[order], intensity=intensity[order], n_threads=3)
    np.testing.assert_array_equal(other.owner, whole.owner[order])
    np.testing.assert_allclose(other.values, whole.values, rtol=1e-5, atol=1e-5)
    threads = compute_voxel_features(xyz, height=height, intensity=intensity, n_threads=2)
    np.testing.assert_array_equal(threads.values, whole.values)


def test_a_second_copy_of_each_point_changes_the_counts_alone(street):
    xyz, height, intensity = street
    once = compute_voxel_features(xyz, height=height, intensity=intensity)
    twice = compute_voxel_features(np.tile(xyz, (2, 1)), height=np.tile(height, 2), intensity=np.tile(intensity, 2))
    different = ~np.isclose(once.values, twice.values, rtol=1e-5, atol=1e-5, equal_nan=True).all(axis=0)
    assert np.flatnonzero(different).tolist() == [voxel_feature_names().index("count")]


def test_any_increasing_function_of_intensity_gives_the_same_table(street):
    xyz, height, intensity = street
    plain = compute_voxel_features(xyz, height=height, intensity=intensity)
    curved = compute_voxel_features(xyz, height=height, intensity=np.exp(3 * intensity) - 7)
    np.testing.assert_array_equal(plain.values, curved.values)


def test_columns_without_intensity_are_missing(street):
    xyz, height, _ = street
    values = compute_voxel_features(xyz, height=height).values
    assert np.flatnonzero(np.isnan(values).all(axis=0)).tolist() == intensity_columns().tolist()


@pytest.mark.parametrize("n", [0, 1])
def test_clouds_of_no_and_one_point(n):
    features = compute_voxel_features(np.zeros((n, 3)), height=np.zeros(n))
    assert features.values.shape == (n, len(voxel_feature_names())) and features.owner.tolist() == [0] * n
    assert not np.isinf(features.values).any()


def test_ranks_of_equal_values_are_shared():
    np.testing.assert_allclose(rank_within([3, -2, 3, 0.5]), [0.75, 0.125, 0.75, 0.375])
    np.testing.assert_allclose(rank_within([-0.0, 0.0]), [0.5, 0.5])


def test_smoothing_is_the_mean_over_27_cells(street):
    xyz, height, _ = street
    features = compute_voxel_features(xyz, height=height)
    values = np.random.default_rng(2).random((len(features.values), 3))
    slow = Voxels(xyz, height)
    number = {name: i for i, name in enumerate(slow.names)}
    for level in (0, 1):
        smooth = smooth_by_cells(features, values, level=level, n_threads=2)
        for i in range(0, len(values), 11):
            near = [number[name] for name in slow.near(slow.names[i], level, 1)]
            np.testing.assert_allclose(smooth[i], values[near].mean(axis=0))


def test_bad_values_are_refused():
    xyz = np.zeros((2, 3))
    with pytest.raises(DataError, match="height"):
        compute_voxel_features(xyz, height=[0.0])
    with pytest.raises(DataError, match=r"intensity is NaN in row 1"):
        compute_voxel_features(xyz, height=[0, 0], intensity=[0, np.nan])
    with pytest.raises(ParameterError, match="voxel_size"):
        compute_voxel_features(xyz, height=[0, 0], voxel_size=0)
    with pytest.raises(DataError, match="too large for voxels"):
        compute_voxel_features(np.array([[0, 0, 0], [1e8, 1e8, 1e8]]), height=[0, 0], voxel_size=1e-3)


@pytest.mark.parametrize("around", [None, 1])
def test_voxels_of_wanted_points_have_the_features_of_all(rng, around):
    xyz = rng.random((4000, 3)) * [12, 9, 3]
    height, intensity, wanted = xyz[:, 2], rng.random(4000), xyz[:, 0] < 5
    whole = compute_voxel_features(xyz, height=height, intensity=intensity)
    part = compute_voxel_features(xyz, height=height, intensity=intensity, wanted=wanted, around=around)
    np.testing.assert_array_equal(part.owner, whole.owner)
    np.testing.assert_array_equal(part.values, whole.values[part.rows])
    flags = np.zeros(len(whole.values), bool)
    flags[whole.owner[wanted]] = True
    if around is not None:
        flags = smooth_by_cells(whole, flags[:, None].astype(float), level=around)[:, 0] > 0
    np.testing.assert_array_equal(part.rows, np.flatnonzero(flags))
    assert 0 < len(part.rows) < len(whole.values)
