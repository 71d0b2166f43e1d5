import lightgbm
import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees

PLAIN = {"objective": "multiclass", "num_class": 3, "min_child_samples": 3, "max_bin": 127, "verbosity": -1}


def table(n, seed=0):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(n, 6)).astype(np.float32)
    values[:, 2] = np.round(values[:, 2])  # values on thresholds
    values[rng.random(n) < 0.3, 1] = np.nan
    return values, (np.nan_to_num(values[:, 1]) + values[:, 2] > 0) + (values[:, 0] > 0.5)


def trained(n_leaves, target=None, **more):
    values, classes = table(1500)
    target = classes if target is None else target
    data = lightgbm.Dataset(values, target, free_raw_data=False)
    return lightgbm.train({**PLAIN, "num_leaves": n_leaves, "num_threads": 1, **more}, data, 8)


@pytest.mark.parametrize("n_leaves", [2, 31, 32, 63, 64])
def test_scores_are_those_of_lightgbm(n_leaves):
    booster = trained(n_leaves)
    trees = BoostedTrees.from_lightgbm(booster.model_to_string())
    values, _ = table(1000, seed=1)
    values[::5, 4] = np.nan  # a feature that was complete in the training
    expected = booster.predict(values, raw_score=True)
    np.testing.assert_allclose(trees.scores(values), expected, atol=1e-6)
    np.testing.assert_array_equal(trees.scores(values, n_threads=3), trees.scores(values))
    again = BoostedTrees.from_arrays(trees.to_arrays())
    np.testing.assert_array_equal(again.scores(values[:7]), trees.scores(values)[:7])


def walked(trees, values):
    """Scores by a walk from the root of each tree to a leaf."""
    sizes = trees.n_leaves.astype(int)
    nodes, leaves = np.cumsum(sizes - 1) - sizes + 1, np.cumsum(sizes) - sizes
    scores = np.tile(trees.initial, (len(values), 1))
    for row, out in zip(values, scores, strict=True):
        for tree, size in enumerate(sizes):
            at = 0 if size > 1 else -1
            while at >= 0:
                node = nodes[tree] + at
                value = row[trees.feature[node]]
                left = trees.missing_left[node] if np.isnan(value) else value <= trees.threshold[node]
                at = int(trees.left[node] if left else trees.right[node])
            out[trees.tree_class[tree]] += np.float64(trees.leaf[leaves[tree] - 1 - at])
    return scores


@pytest.mark.parametrize("n_leaves", [2, 9, 31, 32, 33, 64])
@pytest.mark.parametrize("n_rows", [1, 512, 530])
def test_scores_are_bitwise_those_of_a_walk(n_leaves, n_rows):
    trees = BoostedTrees.from_lightgbm(trained(n_leaves).model_to_string(), initial=[0.1, 0.2, 0.3])
    values, _ = table(n_rows, seed=2)
    values[::7, 4] = np.nan
    np.testing.assert_array_equal(trees.scores(values), walked(trees, values))


def test_trees_of_one_leaf_and_initial_scores():
    booster = trained(31, min_child_samples=5000)
    trees = BoostedTrees.from_lightgbm(booster.model_to_string(), initial=[1.0, 0.0, -1.0])
    values, _ = table(5)
    np.testing.assert_allclose(trees.scores(values), booster.predict(values, raw_score=True) + [1, 0, -1], atol=1e-6)


def test_joined_trees_add_up():
    one, two = (BoostedTrees.from_lightgbm(trained(n).model_to_string(), initial=[n, 0, 0]) for n in (4, 9))
    values, _ = table(50)
    joined = BoostedTrees.joined([one, two])
    np.testing.assert_allclose(joined.scores(values), one.scores(values) + two.scores(values) - [9, 0, 0])
    assert len(joined) == len(one) + len(two)


def test_no_rows_and_wrong_columns():
    trees = BoostedTrees.from_lightgbm(trained(4).model_to_string())
    assert trees.scores(np.zeros((0, 6))).shape == (0, 3)
    with pytest.raises(DataError, match=r"shape \(n, 6\), got \(2, 5\)"):
        trees.scores(np.zeros((2, 5)))


def test_too_large_trees_and_damaged_arrays_are_refused():
    with pytest.raises(DataError, match="more than 64: lower num_leaves"):
        BoostedTrees.from_lightgbm(trained(65, np.random.default_rng(3).integers(0, 3, 1500)).model_to_string())
    trees = BoostedTrees.from_lightgbm(trained(4).model_to_string())
    arrays = trees.to_arrays()
    with pytest.raises(DataError, match="damaged"):
        BoostedTrees.from_arrays({**arrays, "leaf": arrays["leaf"][:-1]})
    with pytest.raises(DataError, match="boosted trees"):
        BoostedTrees.from_arrays({"leaf": arrays["leaf"]})
    with pytest.raises(DataError, match="num_tree_per_iteration"):
        BoostedTrees.from_lightgbm("tree\n")


def test_damaged_trees_are_refused_or_give_finite_scores(rng):
    values, _ = table(200)
    booster = trained(8)
    arrays = BoostedTrees.from_lightgbm(booster.model_to_string()).to_arrays()
    refused = 0
    for _ in range(300):
        name = str(rng.choice([key for key in arrays if arrays[key].ndim]))
        damaged = {key: array.copy() for key, array in arrays.items()}
        bits = damaged[name].reshape(-1).view(np.uint8)
        bits[rng.integers(len(bits))] ^= np.uint8(1 << rng.integers(8)) if damaged[name].dtype != bool else np.uint8(1)
        try:
            got = BoostedTrees.from_arrays(damaged).scores(values)
        except DataError:
            refused += 1
        else:
            assert np.isfinite(got).all()
    assert refused > 50


@pytest.mark.parametrize(("side", "value"), [("left", 0), ("right", 100), ("left", -100), ("right", -1)])
def test_a_child_that_is_none_or_has_two_parents_is_refused(side, value):
    arrays = BoostedTrees.from_lightgbm(trained(8).model_to_string()).to_arrays()
    arrays[side] = arrays[side].copy()
    arrays[side][0] = value
    with pytest.raises(DataError, match="the model is damaged"):
        BoostedTrees.from_arrays(arrays)
