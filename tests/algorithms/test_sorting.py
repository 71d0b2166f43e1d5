"""Radix sort against NumPy's stable sort."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.sorting import radix_argsort


@pytest.mark.parametrize("bits", [1, 10, 11, 12, 40, 62])
def test_equals_stable_argsort(rng, bits):
    keys = rng.integers(0, 2**bits, 5000)
    keys[:500] = keys[500:1000]
    before = keys.copy()
    ordered, order = radix_argsort(keys, bits)
    np.testing.assert_array_equal(order, np.argsort(keys, kind="stable"))
    np.testing.assert_array_equal(ordered, np.sort(keys))
    np.testing.assert_array_equal(keys, before)


def test_nothing_to_sort():
    ordered, order = radix_argsort(np.zeros(0, np.int64), 5)
    assert len(ordered) == len(order) == 0
