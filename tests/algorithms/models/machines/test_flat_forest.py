"""The flattened forest against scikit-learn's own prediction."""

import numpy as np
import pytest
from sklearn.ensemble import RandomForestClassifier

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.models.machines.flat_forest import FlatForest


def grow(rng, *, missing, n=600, n_features=9, **kwargs):
    """Train on noisy data, with NaN in every fifth value if asked for, and return unseen data with NaN and zeros."""
    values = rng.normal(size=(2 * n, n_features)).astype(np.float32)
    target = (values[:, :3].argmax(axis=1) + (rng.random(2 * n) < 0.2)) % 4
    values[rng.random(values.shape) < 0.05] = np.float32(-0.0)
    holes = rng.random(values.shape) < 0.2
    holes[:n] &= missing
    values[holes] = np.nan
    forest = RandomForestClassifier(random_state=3, **{"n_estimators": 12, **kwargs}).fit(values[:n], target[:n])
    return forest, values


@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("kwargs", [{}, {"max_depth": 1}, {"min_samples_leaf": 7, "class_weight": "balanced"}])
def test_probabilities_equal_sklearns(rng, missing, kwargs):
    forest, values = grow(rng, missing=missing, **kwargs)
    flat = FlatForest.from_trees(forest.estimators_)
    assert len(flat) == 12
    got = flat.predict_proba(values)
    assert got.dtype == np.float32
    assert np.abs(got - forest.predict_proba(values)).max() < 1e-6


def test_a_value_that_equals_a_threshold_goes_left(rng):
    values = np.arange(32, dtype=np.float32)[:, None] / 7
    forest = RandomForestClassifier(3, random_state=0).fit(values, np.arange(32) % 3)
    thresholds = np.concatenate([tree.tree_.threshold for tree in forest.estimators_])
    near = thresholds.astype(np.float32)
    probes = np.concatenate([near, np.nextafter(near, np.float32(99)), np.nextafter(near, np.float32(-99))])[:, None]
    got = FlatForest.from_trees(forest.estimators_).predict_proba(probes)
    assert np.abs(got - forest.predict_proba(probes)).max() < 1e-6


def test_a_tree_that_is_one_leaf(rng):
    forest, values = grow(rng, missing=False, min_samples_leaf=400)
    got = FlatForest.from_trees(forest.estimators_).predict_proba(values)
    assert np.abs(got - forest.predict_proba(values)).max() < 1e-6
    assert np.ptp(got, axis=0).max() == 0


def test_the_result_does_not_depend_on_threads_rows_or_a_trip_to_disk(rng, tmp_path):
    forest, values = grow(rng, missing=True)
    flat = FlatForest.from_trees(forest.estimators_)
    before = values.copy()
    expected = flat.predict_proba(values)
    assert expected.tobytes() == flat.predict_proba(values, n_threads=2).tobytes()
    assert expected.tobytes() == np.vstack([flat.predict_proba(row[None]) for row in values]).tobytes()
    np.savez(tmp_path / "forest.npz", **flat.to_arrays())
    with np.load(tmp_path / "forest.npz", allow_pickle=False) as stored:
        again = FlatForest.from_arrays(stored)
    assert expected.tobytes() == again.predict_proba(values).tobytes()
    assert before.tobytes() == values.tobytes()
    assert flat.predict_proba(values[:0]).shape == (0, 4)


def test_bad_input_is_named(rng):
    forest, values = grow(rng, missing=False)
    flat = FlatForest.from_trees(forest.estimators_)
    with pytest.raises(DataError, match=r"features .*got \(1200, 8\)"):
        flat.predict_proba(values[:, :8])
    values[5, 2] = np.inf
    with pytest.raises(DataError, match="features contain infinity in row 5"):
        flat.predict_proba(values)
    with pytest.raises(ParameterError, match="n_threads must be at least 1"):
        flat.predict_proba(values[:2], n_threads=0)
    with pytest.raises(DataError, match="at least one tree"):
        FlatForest.from_trees([])
    arrays = flat.to_arrays()
    with pytest.raises(DataError, match="lack threshold"):
        FlatForest.from_arrays({name: array for name, array in arrays.items() if name != "threshold"})
    with pytest.raises(DataError, match="the forest has 600 features, more than 512"):
        FlatForest.from_arrays({**arrays, "n_features": np.array(600)})
    with pytest.raises(DataError, match="a tree has 5000000 nodes, more than 4194304"):
        FlatForest.from_arrays({**arrays, "roots": np.array([0, 5_000_000])})


def test_damaged_trees_are_refused_or_give_probabilities(rng):
    forest, values = grow(rng, missing=True, n_estimators=3, max_depth=6)
    arrays = FlatForest.from_trees(forest.estimators_).to_arrays()
    refused = 0
    for _ in range(300):
        name = str(rng.choice([key for key in arrays if arrays[key].ndim]))
        damaged = {key: array.copy() for key, array in arrays.items()}
        if rng.random() < 0.1:
            damaged[name] = damaged[name][: rng.integers(len(damaged[name]))]
        else:
            bits = damaged[name].reshape(-1).view(np.uint8)
            bits[rng.integers(len(bits))] ^= (
                np.uint8(1 << rng.integers(8)) if damaged[name].dtype != bool else np.uint8(1)
            )
        try:
            got = FlatForest.from_arrays(damaged).predict_proba(values)
        except DataError:
            refused += 1
        else:
            assert np.isfinite(got).all() and got.min() >= 0 and got.max() < 1.01
    assert refused > 50


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("child", 2**31 - 1, r"node 0 of the forest points to 2147483647, outside"),
        ("child", 0, "node 0 of the forest points to 0, outside"),  # a cycle
        ("feature", 400, "tests a feature that is none of its 9"),
        ("threshold", np.nan, "NaN thresholds"),
    ],
)
def test_a_node_that_leads_nowhere_is_named(rng, name, value, message):
    forest, _ = grow(rng, missing=False, n_estimators=2)
    arrays = FlatForest.from_trees(forest.estimators_).to_arrays()
    arrays[name] = arrays[name].copy()
    arrays[name][0] = value
    with pytest.raises(DataError, match=message):
        FlatForest.from_arrays(arrays)
