"""Sums over the points of superpoints against the same per superpoint."""

import numpy as np

from mlsroad_pipeline.algorithms.models.superpoint_transformer.levels import extremes, means, sum_products


def test_means_leave_out_what_is_not_finite(rng):
    row, columns = rng.integers(0, 9, 300), rng.normal(size=(300, 3)).astype(np.float32)
    columns[rng.random(columns.shape) < 0.2] = np.nan
    columns[0, 0] = np.inf
    row[row == 4] = 5  # no rows
    columns[row == 7, 1] = np.nan
    found = means(row, columns, 10)
    for group in range(10):
        for k in range(3):
            values = columns[row == group, k].astype(np.float64)
            values = values[np.isfinite(values)]
            expected = sum(values.tolist()) / len(values) if len(values) else np.nan
            np.testing.assert_equal(found[group, k], expected)


def test_means_of_integers_and_without_rows():
    assert means(np.array([0, 0, 1]), np.array([[1], [2], [7]], np.uint8), 2).tolist() == [[1.5], [7.0]]
    assert np.isnan(means(np.zeros(0, np.int32), np.zeros((0, 2)), 3)).all()


def test_products_and_radii_are_those_of_the_offsets(rng):
    owner, places, centroid = rng.integers(0, 5, 200), rng.normal(size=(200, 3)), rng.normal(size=(6, 3))
    products, radius = sum_products(owner, places, centroid)
    for group in range(6):
        offset = places[owner == group] - centroid[group]
        np.testing.assert_allclose(products[group], offset.T @ offset, atol=1e-12)
        np.testing.assert_allclose(radius[group], np.linalg.norm(offset, axis=1).max(initial=0.0))


def test_extremes_are_those_of_the_finite_values():
    owner = np.array([0, 0, 0, 1, 2, 2])
    values = np.array([3.0, np.nan, -1.0, np.nan, np.inf, 5.0])
    low, high = extremes(owner, values, 4)
    np.testing.assert_array_equal(low, [-1.0, np.nan, 5.0, np.nan])
    np.testing.assert_array_equal(high, [3.0, np.nan, 5.0, np.nan])
