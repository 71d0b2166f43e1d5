"""Loss of partial labels, weights of classes, and trainings that are interrupted."""

from dataclasses import replace

import lightgbm
import numpy as np
import pytest
from references.patches import SCHEME

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import softmax
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import BoostedTreesParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.sampling import join_voxels
from mlsroad_pipeline.algorithms.models.boosted_trees.training import partial_label_objective, train_trees
from mlsroad_pipeline.model_store.torch_checkpoints import TorchCheckpoints

SMALL = BoostedTreesParameters(rounds=6, min_child_samples=5, leaves=8, checkpoint_rounds=6, seed=3)


def rows(n=800, seed=0):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(n, 5)).astype(np.float32)
    values[rng.random(n) < 0.2, 3] = np.nan
    target = (values[:, 0] > 0).astype(int) + (values[:, 1] + 0.3 * rng.normal(size=n) > 0.5)
    return values, target, rng.uniform(0.5, 2, n)


def one_class(target):
    return np.eye(3, dtype=bool)[target]


def test_one_class_per_row_gives_the_trees_of_lightgbm():
    values, target, weight = rows()
    # Both draw features differently: all are used here.
    trees = train_trees(values, one_class(target), weight, parameters=replace(SMALL, feature_fraction=1.0))
    settings = {
        "objective": "multiclass", "num_class": 3, "num_leaves": 8, "learning_rate": 0.1, "min_child_samples": 5,
        "extra_trees": True, "lambda_l2": 1.0, "max_bin": 127, "deterministic": True,
        "force_row_wise": True, "num_threads": 1, "verbosity": -1, "extra_seed": 3,
    }  # fmt: skip
    booster = lightgbm.train(settings, lightgbm.Dataset(values, target, weight=weight, params=settings), 6)
    np.testing.assert_allclose(softmax(trees.scores(values)), booster.predict(values), atol=1e-6)


def test_gradient_is_that_of_the_loss():
    rng = np.random.default_rng(1)
    scores, weight = rng.normal(size=(40, 4)), rng.uniform(0.1, 3, 40)
    allowed = rng.random((40, 4)) < 0.5
    allowed[~allowed.any(axis=1), 0] = True
    gradient, hessian = partial_label_objective(allowed, weight)(scores, None)

    def loss(at):
        return -np.log((softmax(at) * allowed).sum(axis=1)) * weight

    for c in range(4):
        step = 1e-5 * np.eye(4)[c]
        np.testing.assert_allclose(gradient[:, c], (loss(scores + step) - loss(scores - step)) / 2e-5, atol=1e-5)
    p = softmax(scores)
    np.testing.assert_allclose(hessian, p * (1 - p) * 4 / 3 * weight[:, None], rtol=1e-5)
    assert not gradient[allowed.all(axis=1)].any()  # all classes are allowed: nothing to learn


def test_labels_of_two_classes_teach_what_they_exclude():
    values, target, weight = rows(3000)
    vague = (target > 0) & (np.random.default_rng(2).random(len(target)) < 0.9)
    allowed = one_class(target)
    allowed[vague] = [False, True, True]
    parameters = replace(SMALL, rounds=200, checkpoint_rounds=200, feature_fraction=1.0)
    more, expected, _ = rows(2000, seed=5)

    def found(labels, keep):
        trees = train_trees(values[keep], labels[keep], weight[keep], parameters=parameters)
        return trees.scores(more).argmax(axis=1)

    both, certain = found(allowed, np.ones(len(values), bool)), found(allowed, ~vague)
    assert (both == expected).mean() > (certain == expected).mean() + 0.02
    assert ((both > 0) == (expected > 0)).mean() > 0.9


def test_threads_do_not_change_the_trees():
    values, target, weight = rows(1000)
    one, two = (
        train_trees(values, one_class(target), weight, parameters=replace(SMALL, rounds=1), n_threads=n) for n in (1, 2)
    )
    for name, array in one.to_arrays().items():
        np.testing.assert_array_equal(two.to_arrays()[name], array)


class Interrupted(Exception):
    pass


class FailingCheckpoints(TorchCheckpoints):
    def save(self, name, state):
        super().save(name, state)
        if len(state["parts"]) == 2:
            raise Interrupted


def test_an_interrupted_training_resumes_with_the_same_bytes(tmp_path):
    values, target, weight = rows()
    parameters = replace(SMALL, checkpoint_rounds=2)
    whole = train_trees(values, one_class(target), weight, parameters=parameters)
    with pytest.raises(Interrupted):
        train_trees(
            values, one_class(target), weight, parameters=parameters, checkpoints=FailingCheckpoints(tmp_path / "c")
        )
    store = TorchCheckpoints(tmp_path / "c")
    resumed = train_trees(values, one_class(target), weight, parameters=parameters, checkpoints=store)
    for name, array in whole.to_arrays().items():
        np.testing.assert_array_equal(resumed.to_arrays()[name], array)
    assert len(whole) == 18 and not (tmp_path / "c").exists()


def test_a_checkpoint_of_other_rows_is_not_used(tmp_path):
    values, target, weight = rows()
    parameters = replace(SMALL, checkpoint_rounds=2)
    with pytest.raises(Interrupted):
        train_trees(
            values, one_class(target), weight, parameters=parameters, checkpoints=FailingCheckpoints(tmp_path / "c")
        )
    plain = train_trees(values, one_class(target), 2 * weight, parameters=parameters)
    other = train_trees(
        values, one_class(target), 2 * weight, parameters=parameters, checkpoints=TorchCheckpoints(tmp_path / "c")
    )
    np.testing.assert_array_equal(other.leaf, plain.leaf)


def scene(counts, found, sets):
    numbers = np.repeat(np.arange(len(counts)), counts).astype(np.int16)
    return {
        "values": np.zeros((len(numbers), 2), np.float32), "rows": numbers,
        "sets": np.array(sets, dtype=bool), "found": np.array(found),
    }  # fmt: skip


def test_weights_follow_shares_as_found_sources_and_prior():
    n = len(SCHEME)
    names, plain = SCHEME.classes, np.eye(n, dtype=bool)
    rest = [0] * (n - 2)
    one, two = scene([10, 10, *rest], [100, 10, *rest], plain), scene([5, 0, *rest], [5, 0, *rest], plain)
    _, allowed, weight = join_voxels([one, two], scheme=SCHEME, prior={}, weights=[3, 1], sources=["x", "y"])
    by_class = np.array([weight[:10].sum(), weight[10:20].sum(), weight[20:].sum()])
    np.testing.assert_allclose(by_class / weight.sum(), [3 / 4 * 10 / 11, 3 / 4 / 11, 1 / 4])
    assert weight.mean() == pytest.approx(1) and allowed.sum() == 25
    prior = {name: 1.0 for name in names} | {names[1]: 3.0}
    _, _, weight = join_voxels([one], scheme=SCHEME, prior=prior)
    assert weight[10:].sum() / weight[:10].sum() == pytest.approx(3)
    both = np.concatenate([plain, plain[:1] | plain[1:2]])
    vague = scene([10, 0, *rest, 10], [10, 0, *rest, 10], both)
    _, _, weight = join_voxels([vague], scheme=SCHEME, prior=prior)
    # Class 0 has half its share in rows that allow it alone; class 1 has all of its share in the other rows.
    assert weight[10:].sum() / weight[:10].sum() == pytest.approx((0.5 + 3) / 0.5)


def test_what_cannot_be_trained_on_is_refused():
    n = len(SCHEME)
    with pytest.raises(DataError, match="no labelled points"):
        join_voxels([scene([0] * n, [0] * n, np.eye(n))], scheme=SCHEME, prior={})
    with pytest.raises(DataError, match="class sets have 2 classes"):
        join_voxels([scene([1, 0], [1, 0], np.eye(2))], scheme=SCHEME, prior={})
    with pytest.raises(ParameterError, match="check 'moon'"):
        join_voxels([scene([1] * n, [1] * n, np.eye(n))], scheme=SCHEME, prior={"moon": 1.0})


@pytest.mark.parametrize(
    "values",
    [
        {"rounds": 0},
        {"leaves": 65},
        {"smoothing": 1.5},
        {"feature_fraction": 0},
        {"prior": {"road": 0}},
        {"max_bin": 1},
    ],
)
def test_parameters_outside_their_domain_are_refused(values):
    with pytest.raises(ParameterError, match=f"boosted_trees.{next(iter(values))}"):
        BoostedTreesParameters(**values)
