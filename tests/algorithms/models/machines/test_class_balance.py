"""Majority labels, balanced samples and class weights against hand-counted cases."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.features.supervoxel_features import SupervoxelFeatures
from mlsroad_pipeline.algorithms.models.machines.class_balance import class_weights, draw_per_class, majority_labels
from mlsroad_pipeline.algorithms.models.machines.flat_forest import FlatForest
from mlsroad_pipeline.papers.tomic2019.detrended_forest.labeller import forest_probabilities
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import ForestParameters, grow_forest


@pytest.fixture
def overlap(rng):
    """Two classes of very different size that one noisy feature hardly parts."""
    labels = np.repeat([0, 1], [900, 36])
    values = rng.normal(size=(len(labels), 2)).astype(np.float32)
    values[:, 0] += 1.2 * labels
    return values, labels


def test_samples_have_a_maximum_size_per_class():
    target = np.repeat([0, 1, 2, -1], [50, 4, 10, 30])[np.random.default_rng(0).permutation(94)]
    rows = draw_per_class(target, 10, seed=3)
    assert np.bincount(target[rows]).tolist() == [10, 4, 10]
    assert (np.diff(rows) > 0).all()
    assert np.array_equal(rows, draw_per_class(target, 10, seed=3))
    assert not np.array_equal(rows, draw_per_class(target, 10, seed=4))
    assert np.array_equal(draw_per_class(target, None, seed=3), np.flatnonzero(target >= 0))
    assert len(draw_per_class(np.full(3, -1), 10, seed=0)) == 0


@pytest.mark.parametrize(("kind", "totals"), [("balanced", (1, 1)), ("sqrt", (30, 6)), ("none", (900, 36))])
def test_total_class_weights_do_not_depend_on_the_sample_size(kind, totals):
    sizes = np.array([900, 36])
    for drawn in (sizes, np.array([100, 36])):
        weights = class_weights(sizes, drawn, kind) or {0: 1.0, 1: 1.0}
        together = np.array([weights[c] * drawn[c] for c in (0, 1)])
        assert together[0] / together[1] == pytest.approx(totals[0] / totals[1])
        assert together.sum() == pytest.approx(drawn.sum())
    assert class_weights(sizes, sizes, "none") is None


def grow(values, labels, *, n_jobs=1, **changes):
    """Return the probabilities of a forest on its own training data, and its out-of-bag error."""
    parameters = ForestParameters(**{"min_samples_leaf": 20, "max_features": 0.5, "seed": 0, **changes})
    table = SupervoxelFeatures(values, ("a", "b"), np.zeros((len(values), 3)), np.ones(len(values), np.int64))
    grown = grow_forest(table, labels, parameters, n_classes=2, n_jobs=n_jobs)
    return forest_probabilities(FlatForest.from_arrays(grown.arrays), grown.arrays, values), grown.oob_error


def test_a_larger_weight_raises_the_recall_of_a_rare_class(overlap):
    found = [
        (grow(*overlap, n_trees=60, class_weight=kind)[0].argmax(axis=1) == 1).mean()
        for kind in ("none", "sqrt", "balanced")
    ]
    assert found[0] < found[1] < found[2]


def test_weights_compensate_for_sampling(overlap):
    one, two = (
        grow(*overlap, n_trees=150, class_weight="sqrt", max_per_class=limit)[0][:, 1].mean() for limit in (300, 900)
    )
    assert one == pytest.approx(two, abs=0.05)


def test_a_forest_on_samples_does_not_depend_on_the_jobs(overlap):
    one, two = (
        grow(*overlap, n_trees=9, min_samples_leaf=5, class_weight="sqrt", max_per_class=50, n_jobs=jobs)
        for jobs in (1, 2)
    )
    assert [part.tobytes() for part in one] == [part.tobytes() for part in two]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"max_per_class": 0}, "detrended_forest.max_per_class must be at least 1, got 0"),
        ({"n_trees": 0}, "detrended_forest.n_trees must be at least 1, got 0"),
        ({"min_samples_leaf": 0}, "detrended_forest.min_samples_leaf must be at least 1, got 0"),
        ({"class_weight": "fair"}, "class_weight must be 'sqrt', 'balanced' or 'none', got 'fair'"),
        ({"smoothing": 1.0}, r"smoothing must be in \[0, 1\), got 1.0"),
        ({"smoothing": -0.1}, r"smoothing must be in \[0, 1\), got -0.1"),
    ],
)
def test_parameters_outside_their_domain_are_named(values, message):
    with pytest.raises(ParameterError, match=message):
        ForestParameters(**values)


def test_the_majority_is_counted_without_ignored_points():
    labels, purity = majority_labels([0, 1, 1, -1, -1, 2, 0, 2], [0, 0, 0, 0, 1, 2, 2, 4], 3)
    assert labels.dtype == np.int16
    assert labels.tolist() == [1, -1, 0, -1, 2]  # of equal counts the lowest class; 1 and 3 have no labelled point
    assert np.allclose(purity, [2 / 3, np.nan, 1 / 2, np.nan, 1], equal_nan=True)
    labels, purity = majority_labels([], [], 3)
    assert (len(labels), len(purity)) == (0, 0)


def test_majority_labels_name_bad_input():
    with pytest.raises(DataError, match=r"point_labels .*got 0\.\.2"):
        majority_labels([0, 2], [0, 0], 2)
    with pytest.raises(DataError, match=r"point_labels .*got \(2,\)"):
        majority_labels([0, 1], [0, 0, 0], 2)
    with pytest.raises(DataError, match=r"group_of_point .*got -2"):
        majority_labels([0, 1], [0, -2], 2)
