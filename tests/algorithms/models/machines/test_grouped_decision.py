import numpy as np
import pytest

from mlsroad_pipeline.algorithms.models.machines.combinations import decide, largest_of_rows


@pytest.mark.parametrize("groups", [None, [0, 1, 2, 3], [0, 1, 1, 0], [2, 2, 0, 2]])
def test_the_best_class_of_the_best_group_is_taken(rng, groups):
    probabilities = rng.dirichlet(np.ones(4), 500)
    probabilities[::5] = rng.integers(0, 2, (100, 4)) / 2  # ties
    labels, confidence = decide(probabilities, None if groups is None else np.array(groups))
    for row, label, known in zip(probabilities, labels, confidence, strict=True):
        of_group = [sum(row[c] for c in range(4) if groups is None or groups[c] == g) for g in range(4)]
        if groups is None:
            of_group = row.tolist()
        group = max(range(4), key=of_group.__getitem__)  # the first of equal ones
        members = [c for c in range(4) if (c if groups is None else groups[c]) == group]
        assert label == max(members, key=row.__getitem__)
        assert known == pytest.approx(of_group[group])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_largest_values_of_rows_are_those_of_numpy(rng, dtype):
    values = rng.normal(size=(200, 5)).astype(dtype)
    values[::7, rng.integers(0, 5)] = np.nan
    largest = largest_of_rows(values)
    assert largest.dtype == dtype
    np.testing.assert_array_equal(largest, values.max(axis=1, keepdims=True))
