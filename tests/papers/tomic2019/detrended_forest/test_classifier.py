"""The forest classifier against scikit-learn, its guarantees, and real recordings."""

import gzip
import warnings

import numpy as np
import pytest
from scipy.sparse import csr_array
from sklearn.base import clone
from sklearn.ensemble import RandomForestClassifier
from sklearn.exceptions import NotFittedError

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.features.supervoxel_features import SupervoxelFeatures, compute_supervoxel_features
from mlsroad_pipeline.algorithms.geometry.cells import build_cell_grids
from mlsroad_pipeline.algorithms.models.machines.class_balance import majority_labels
from mlsroad_pipeline.papers.tomic2019.detrended_forest.classifier import DetrendedForestClassifier
from mlsroad_pipeline.papers.tomic2019.detrended_forest.labeller import label_points


@pytest.fixture
def blobs(rng):
    """Three overlapping classes, one of them rare; the last feature is noise."""
    labels = np.repeat([0, 1, 2], [120, 120, 12])
    values = rng.normal(size=(len(labels), 4)).astype(np.float32)
    values[np.arange(len(labels)), labels] += 2.5
    values[rng.random(values.shape) < 0.05] = np.nan
    return values, labels


def named(values, names=("a", "b", "c", "noise")):
    return SupervoxelFeatures(values, names, np.zeros((len(values), 3)), np.ones(len(values), np.int64))


def fit(values, labels, **kwargs):
    return DetrendedForestClassifier(**{"n_classes": 3, "n_trees": 25, **kwargs}).fit(values, labels)


def test_it_is_sklearns_forest(blobs):
    values, labels = blobs
    model = fit(values, labels)
    reference = RandomForestClassifier(
        25, min_samples_leaf=5, class_weight="balanced_subsample", random_state=0, oob_score=True
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # scikit-learn warns of supervoxels that every tree has seen
        reference.fit(values, labels)
    assert np.abs(model.predict_proba(values) - reference.predict_proba(values)).max() < 1e-6
    assert list(model.feature_importances_.values()) == pytest.approx(reference.feature_importances_)
    # One forest, two ways to count: scikit-learn takes supervoxels without a vote for class 0.
    voted = reference.oob_decision_function_.any(axis=1)
    right = reference.oob_decision_function_[voted].argmax(axis=1) == labels[voted]
    assert voted[labels == 2].any()
    assert model.oob_score_ == pytest.approx(right.mean())
    by_class = [1 - right[labels[voted] == c].mean() for c in range(3)]
    assert model.oob_balanced_error_curve_[-1] == pytest.approx(np.mean(by_class))


def test_the_out_of_bag_error_falls_with_the_number_of_trees(blobs):
    model = fit(*blobs, n_trees=60)
    assert model.oob_error_curve_.shape == model.oob_balanced_error_curve_.shape == (60,)
    assert model.oob_error_curve_[-1] == pytest.approx(1 - model.oob_score_)
    assert model.oob_error_curve_[-10:].mean() < model.oob_error_curve_[:3].mean()


def test_the_same_seed_gives_the_same_bytes_whatever_the_jobs(blobs):
    values, labels = blobs
    before = values.copy()
    one, two = fit(values, labels), fit(values, labels, n_jobs=2)
    assert one.predict_proba(values).tobytes() == two.predict_proba(values).tobytes()
    assert one.oob_error_curve_.tobytes() == two.oob_error_curve_.tobytes()
    assert one.predict_proba(values).tobytes() != fit(values, labels, random_state=1).predict_proba(values).tobytes()
    assert before.tobytes() == values.tobytes()


def test_without_the_out_of_bag_error_the_forest_is_the_same(blobs):
    values, labels = blobs
    one, two = fit(values, labels), fit(values, labels, out_of_bag=False)
    assert one.predict_proba(values).tobytes() == two.predict_proba(values).tobytes()
    assert hasattr(one, "oob_error_curve_") and not hasattr(two, "oob_error_curve_")


def test_it_survives_a_trip_to_disk_without_pickles(blobs, tmp_path):
    values, labels = blobs
    model = fit(named(values), labels)
    np.savez(tmp_path / "model.npz", **model.to_arrays())
    with np.load(tmp_path / "model.npz", allow_pickle=False) as stored:
        again = DetrendedForestClassifier.from_arrays(stored)
    assert again.predict_proba(named(values)).tobytes() == model.predict_proba(named(values)).tobytes()
    assert again.feature_importances_ == model.feature_importances_
    assert again.feature_names_in_ == ("a", "b", "c", "noise")
    with pytest.raises(DataError, match="lack n_classes, trained_classes"):
        DetrendedForestClassifier.from_arrays({})


def test_importances_carry_names_and_find_the_noise(blobs):
    values, labels = blobs
    importances = fit(named(values), labels).feature_importances_
    assert min(importances, key=importances.get) == "noise"
    assert sum(importances.values()) == pytest.approx(1)


def test_ignored_supervoxels_are_not_trained_on(blobs):
    values, labels = blobs
    noisy = np.vstack([values, np.full((30, 4), 7, np.float32)])
    with_ignored = fit(noisy, np.concatenate([labels, np.full(30, -1)]))
    assert with_ignored.predict_proba(values).tobytes() == fit(values, labels).predict_proba(values).tobytes()


def test_classes_absent_from_training_get_probability_zero(blobs):
    values, labels = blobs
    with pytest.warns(UserWarning, match=r"no supervoxels of classes \[1, 4\]: they are never predicted"):
        model = fit(values, np.where(labels == 1, 3, labels), n_classes=5)
    probabilities = model.predict_proba(values)
    assert probabilities.shape == (len(values), 5)
    assert probabilities[:, [1, 4]].max() == 0
    assert np.allclose(probabilities.sum(axis=1), 1, atol=1e-6)
    assert (model.trained_classes_.tolist(), model.missing_classes_.tolist()) == ([0, 2, 3], [1, 4])
    assert set(np.unique(model.predict(values))) <= {0, 2, 3}


def test_a_class_with_one_supervoxel_is_trained_on(blobs):
    values, labels = blobs
    few = np.flatnonzero((labels < 2) | (np.arange(len(labels)) == 250))
    model = fit(values[few], labels[few])
    assert model.trained_classes_.tolist() == [0, 1, 2]
    assert model.predict_proba(values[[250]])[0, 2] > 0.3


def test_weights_count(blobs):
    values, labels = blobs
    weight = np.where(labels == 2, 0.0, 1.0)
    model = DetrendedForestClassifier(3, n_trees=5, class_weight=None).fit(values, labels, sample_weight=weight)
    assert model.predict_proba(values)[:, 2].max() == 0


def test_it_can_be_cloned_like_any_estimator():
    model = DetrendedForestClassifier(4, n_trees=7, min_samples_leaf=3)
    assert clone(model).get_params() == model.get_params()


def test_bad_input_is_named(blobs):
    values, labels = blobs
    with pytest.raises(DataError, match="none of 252 supervoxels is labelled"):
        fit(values, np.full(252, -1))
    with pytest.raises(DataError, match="all 252 labelled supervoxels have class 2"):
        fit(values, np.full(252, 2))
    with pytest.raises(DataError, match=r"labels .*got 0\.\.2"):
        fit(values, labels, n_classes=2)
    with pytest.raises(DataError, match=r"labels .*got \(3,\)"):
        fit(values, labels[:3])
    with pytest.raises(DataError, match=r"features .*got \(252,\)"):
        fit(values[:, 0], labels)
    with pytest.raises(DataError, match="features contain infinity in row 1"):
        fit(np.where(np.arange(252)[:, None] == 1, np.inf, values), labels)
    for weight, message in ((np.ones(2), "must have shape"), (np.full(252, -1), "not negative")):
        with pytest.raises(DataError, match=message):
            DetrendedForestClassifier(3).fit(values, labels, sample_weight=weight)
    with pytest.raises(NotFittedError, match="call fit first"):
        DetrendedForestClassifier().predict_proba(values)


def test_features_that_differ_from_training_are_rejected(blobs):
    values, labels = blobs
    model = fit(named(values), labels)
    with pytest.raises(DataError, match=r"features differ from those of training: \['luma', 'noise'\]"):
        model.predict_proba(named(values, ("a", "b", "c", "luma")))
    with pytest.raises(DataError, match="their order"):
        model.predict_proba(named(values, ("b", "a", "c", "noise")))
    with pytest.raises(DataError, match=r"features .*got \(252, 3\)"):
        model.predict_proba(values[:, :3])


@pytest.mark.parametrize(
    ("name", "value"),
    [("n_trees", 0), ("n_trees", 2.5), ("max_depth", 0), ("min_samples_leaf", 0), ("n_jobs", 0), ("n_classes", 0)],
)
def test_parameters_outside_their_domain_are_named(blobs, name, value):
    with pytest.raises(ParameterError, match=rf"{name} .*got {value}"):
        fit(*blobs, **{name: value})


def test_an_unknown_class_weight_is_named(blobs):
    with pytest.raises(ParameterError, match=r"class_weight .*got 'fair'"):
        fit(*blobs, class_weight="fair")


def partition(xyz, size):
    """Put points in voxels; those that share a face are neighbours."""
    (grid,) = build_cell_grids(xyz, cell_size=size)
    owners = np.empty(len(xyz), np.int32)
    owners[grid.order] = np.repeat(np.arange(len(grid.keys)), np.diff(grid.starts))
    pairs = []
    for step in (1, grid.shape[0], grid.shape[0] * grid.shape[1]):
        at = np.searchsorted(grid.keys, grid.keys + step).clip(max=len(grid.keys) - 1)
        near = np.flatnonzero(grid.keys[at] == grid.keys + step)
        pairs.append(np.stack([near, at[near]]))
    rows, columns = np.hstack(pairs)
    ends = (np.r_[rows, columns], np.r_[columns, rows])
    return owners, csr_array((np.ones(len(ends[0]), np.int8), ends), shape=(len(grid.keys),) * 2)


@pytest.mark.real_data
def test_ground_and_objects_are_separated_on_a_real_street(real_data):
    """Learn one block of Oakland and label another: ground, and anything else."""
    scenes = []
    for block in ("part2_ac", "part3_aj"):
        with gzip.open(real_data("oakland", f"oakland_{block}.xyz_label_conf.gz"), "rt") as lines:
            table = np.loadtxt([line for line in lines if line[0].isdigit() or line[0] == "-"], usecols=(0, 1, 2, 3))
        xyz, codes = table[::2, :3], table[::2, 3]
        owners, adjacency = partition(xyz, 0.6)
        features = compute_supervoxel_features(xyz, owners, adjacency)
        scenes.append((xyz, np.isin(codes, [1200, *range(1202, 1207), 1301]).astype(int), owners, features))
    (_, truth, owners, features), (xyz, unseen_truth, _, unseen) = scenes
    model = DetrendedForestClassifier(2, n_trees=20).fit(features, majority_labels(truth, owners, 2)[0])
    labels, confidence = label_points(xyz, unseen.centroids, model.predict_proba(unseen))
    assert np.mean(labels == unseen_truth) > 0.98
    assert 0.5 <= confidence.min() <= confidence.max() <= 1
