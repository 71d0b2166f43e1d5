"""Sorting and ranking against NumPy and SciPy."""

import numpy as np
import pytest
from scipy.stats import rankdata

from mlsroad_pipeline.algorithms.geometry.sorting import (
    lower_bound,
    median_of,
    order_of,
    radix_argsort,
    rank_few,
    rank_floats,
    rank_integers,
    sort_floats,
)


@pytest.mark.parametrize("bits", [1, 10, 11, 12, 40, 62])
def test_equals_stable_argsort(rng, bits):
    keys = rng.integers(0, 2**bits, 5000)
    keys[:500], keys[1000::3] = keys[500:1000], keys[0]
    before = keys.copy()
    ordered, order = radix_argsort(keys, bits)
    np.testing.assert_array_equal(order, np.argsort(keys, kind="stable"))
    np.testing.assert_array_equal(ordered, np.sort(keys))
    np.testing.assert_array_equal(keys, before)


def test_nothing_to_sort():
    ordered, order = radix_argsort(np.zeros(0, np.int64), 5)
    assert len(ordered) == len(order) == 0
    ordered, order = radix_argsort(np.zeros(4, np.int64), 0)
    assert ordered.tolist() == [0, 0, 0, 0] and order.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("low, high", [(-5, 5), (0, 100_000), (-(2**60), 2**60), (7, 8)])
@pytest.mark.parametrize("dtype", [np.int16, np.int64])
def test_integers_are_ranked_as_numpy_does(rng, low, high, dtype):
    limits = np.iinfo(dtype)
    values = rng.integers(max(low, limits.min), min(high, limits.max), 3000).astype(dtype)
    names, ranks = rank_integers(values)
    expected, places = np.unique(values, return_inverse=True)
    assert names.dtype == ranks.dtype == np.int64
    np.testing.assert_array_equal(names, expected)
    np.testing.assert_array_equal(ranks, places)


def test_no_integers_have_no_ranks():
    names, ranks = rank_integers(np.zeros(0, np.int32))
    assert len(names) == len(ranks) == 0


@pytest.mark.parametrize("keys", ["distinct", "repeated", "wide", "negative", "none"])
def test_order_of_integers_is_stable(rng, keys):
    values = {
        "distinct": rng.permutation(6000)[:3000] + 77,
        "repeated": rng.integers(0, 2000, 3000),
        "wide": rng.integers(-(2**60), 2**60, 3000),
        "negative": rng.permutation(300) - 299,
        "none": np.zeros(0, np.int64),
    }[keys]
    ordered, order = order_of(values)
    assert ordered.dtype == np.int64 and order.dtype == np.int32
    np.testing.assert_array_equal(order, np.argsort(values, kind="stable"))
    np.testing.assert_array_equal(ordered, np.sort(values))


@pytest.mark.parametrize("spread", ["even", "few levels", "skewed", "one value", "huge"])
@pytest.mark.parametrize("n", [1, 2, 50, 3000])
def test_numbers_are_ranked_as_scipy_does(rng, spread, n):
    values = {
        "even": rng.uniform(-5, 5, n),
        "few levels": rng.integers(0, 7, n) / 7,
        "skewed": rng.lognormal(0, 8, n),
        "one value": np.full(n, 0.3),
        "huge": rng.uniform(-1.5, 1.5, n) * 1e308,
    }[spread]
    np.testing.assert_array_equal(rank_floats(values), rankdata(values))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("levels", [2, 256, 65536])
def test_levels_are_ranked_as_scipy_does(rng, dtype, levels):
    values = (rng.integers(0, levels, 5000) / (levels - 1)).astype(dtype)
    np.testing.assert_array_equal(rank_few(values), rankdata(values))


def test_levels_that_share_an_interval_are_not_ranked():
    assert rank_few(np.array([0.0, 1e-9, 1.0])) is None
    assert rank_few(np.array([-1e308, 1e308])) is None
    assert rank_few(np.full(3, 0.2)).tolist() == [2.0, 2.0, 2.0] and len(rank_few(np.zeros(0))) == 0


@pytest.mark.parametrize("n", [0, 1, 2, 3, 7, 8, 500, 1001])
@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int32])
def test_the_first_values_are_sorted_and_others_stay(rng, n, dtype):
    values = rng.normal(0, 20, n + 3).astype(dtype)
    values[: n // 3] = values[n // 3 : 2 * (n // 3)]
    expected = np.concatenate([np.sort(values[:n]), values[n:]])
    sort_floats(values, n)
    np.testing.assert_array_equal(values, expected)


@pytest.mark.parametrize("n", [1, 2, 9, 40])
def test_median_and_first_row_of_a_value_are_those_of_numpy(rng, n):
    values = rng.integers(0, 12, n).astype(np.float64)
    assert median_of(values.copy(), n) == np.median(values)
    ascending = np.sort(values)
    for wanted in np.arange(-1.0, 13.0, 0.5):
        assert lower_bound(ascending, wanted) == np.searchsorted(ascending, wanted)
