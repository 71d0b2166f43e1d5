"""Compact forests: the tree structure is kept, thresholds and probabilities are rounded within stated limits."""

import numpy as np
import pytest
from sklearn.ensemble import RandomForestClassifier

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.compact_forest import compact_forest, expanded_forest
from mlsroad_pipeline.algorithms.models.flat_forest import FlatForest


@pytest.fixture(scope="module")
def grown():
    rng = np.random.default_rng(3)
    values = rng.normal(size=(1500, 9)).astype(np.float32)
    values[rng.random(values.shape) < 0.1] = np.nan
    labels = (np.nan_to_num(values[:, 0]) > 0).astype(int) + 2 * (np.nan_to_num(values[:, 3]) > 0.5)
    model = RandomForestClassifier(20, min_samples_leaf=2, random_state=0).fit(values, labels)
    return FlatForest.from_trees(model.estimators_), values


def test_structure_is_exact_and_values_are_rounded(grown):
    plain = grown[0].to_arrays()
    again = expanded_forest(compact_forest({**plain, "n_classes": np.array(4)}))
    assert again["n_classes"] == 4
    for name in ("roots", "feature", "missing_left", "n_features"):
        np.testing.assert_array_equal(again[name], plain[name])
    inner = plain["feature"] >= 0
    np.testing.assert_array_equal(again["child"][inner], plain["child"][inner])
    np.testing.assert_allclose(again["threshold"], plain["threshold"], rtol=2**-11, atol=2**-25)
    leaves = [arrays["leaf_values"][arrays["child"][~inner]] for arrays in (again, plain)]
    np.testing.assert_allclose(*leaves, atol=1 / 255)
    np.testing.assert_allclose(again["leaf_values"].sum(axis=1), 1, atol=1e-6)


def test_probabilities_stay_close_and_the_size_falls_to_a_fifth(grown):
    forest, values = grown
    compact = compact_forest(forest.to_arrays())
    found = FlatForest.from_arrays(compact).predict_proba(values)
    expected = forest.predict_proba(values)
    assert (found.argmax(axis=1) == expected.argmax(axis=1)).mean() > 0.995
    assert np.abs(found - expected).mean() < 0.002
    assert 5 * sum(a.nbytes for a in compact.values()) < sum(a.nbytes for a in forest.to_arrays().values())


def test_infinite_thresholds_of_missing_values_are_kept(grown):
    plain = grown[0].to_arrays()
    inner = np.flatnonzero(plain["feature"] >= 0)
    threshold = plain["threshold"].copy()
    threshold[inner[0]] = np.inf
    assert expanded_forest(compact_forest({**plain, "threshold": threshold}))["threshold"][inner[0]] == np.inf
    threshold[inner[0]] = 1e6
    with pytest.raises(DataError, match=r"a threshold of 1e\+06 exceeds the range of float16"):
        compact_forest({**plain, "threshold": threshold})


def test_missing_arrays_are_named(grown):
    compact = compact_forest(grown[0].to_arrays())
    del compact["thresholds"]
    with pytest.raises(DataError, match="thresholds"):
        FlatForest.from_arrays(compact)
