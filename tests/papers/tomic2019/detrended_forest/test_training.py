"""Training of forests against scikit-learn, its guarantees, and real recordings."""

import gzip
import warnings

import numpy as np
import pytest
from scipy.sparse import csr_array
from sklearn.ensemble import RandomForestClassifier

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.features.supervoxel_features import SupervoxelFeatures, compute_supervoxel_features
from mlsroad_pipeline.algorithms.geometry.cells import build_cell_grids
from mlsroad_pipeline.algorithms.models.machines.class_balance import majority_labels
from mlsroad_pipeline.algorithms.models.machines.flat_forest import FlatForest
from mlsroad_pipeline.papers.tomic2019.detrended_forest.labeller import forest_probabilities, label_points
from mlsroad_pipeline.papers.tomic2019.detrended_forest.training import ForestParameters, grow_forest


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


def fit(values, labels, *, n_classes=3, n_jobs=1, fallback=False, **changes):
    parameters = ForestParameters(
        **{"n_trees": 25, "fallback_trees": 25, "min_samples_leaf": 5, "max_features": 0.5, "seed": 0, **changes}
    )
    return grow_forest(named(values), labels, parameters, n_classes=n_classes, n_jobs=n_jobs, fallback=fallback)


def probabilities(grown, values):
    return forest_probabilities(FlatForest.from_arrays(grown.arrays), grown.arrays, values)


def test_it_is_sklearns_forest(blobs):
    values, labels = blobs
    model = fit(values, labels)
    reference = RandomForestClassifier(
        25, min_samples_leaf=5, class_weight="balanced_subsample", random_state=0, oob_score=True
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # scikit-learn warns of supervoxels that every tree has seen
        reference.fit(values, labels)
    assert np.abs(probabilities(model, values) - reference.predict_proba(values)).max() < 1e-6
    assert list(model.importances.values()) == pytest.approx(reference.feature_importances_)
    # One forest, two ways to count: scikit-learn takes supervoxels without a vote for class 0.
    voted = reference.oob_decision_function_.any(axis=1)
    right = reference.oob_decision_function_[voted].argmax(axis=1) == labels[voted]
    assert voted[labels == 2].any()
    assert 1 - model.oob_error[-1] == pytest.approx(right.mean())


def test_the_out_of_bag_error_falls_with_the_number_of_trees(blobs):
    model = fit(*blobs, n_trees=60)
    assert model.oob_error.shape == (60,)
    assert model.oob_error[-10:].mean() < model.oob_error[:3].mean()


def test_the_same_seed_gives_the_same_bytes_whatever_the_jobs(blobs):
    values, labels = blobs
    before = values.copy()
    one, two = fit(values, labels), fit(values, labels, n_jobs=2)
    assert probabilities(one, values).tobytes() == probabilities(two, values).tobytes()
    assert one.oob_error.tobytes() == two.oob_error.tobytes()
    assert probabilities(one, values).tobytes() != probabilities(fit(values, labels, seed=1), values).tobytes()
    assert before.tobytes() == values.tobytes()


def test_a_fallback_of_as_many_trees_is_the_same_forest_without_the_out_of_bag_error(blobs):
    values, labels = blobs
    one, two = fit(values, labels), fit(values, labels, fallback=True)
    assert probabilities(one, values).tobytes() == probabilities(two, values).tobytes()
    assert (len(one.oob_error), len(two.oob_error)) == (25, 0)


def test_it_survives_a_trip_to_disk_without_pickles(blobs, tmp_path):
    values, labels = blobs
    model = fit(values, labels)
    np.savez(tmp_path / "model.npz", **model.arrays)
    with np.load(tmp_path / "model.npz", allow_pickle=False) as stored:
        again = forest_probabilities(FlatForest.from_arrays(stored), stored, values)
        importances = dict(zip(stored["feature_names"].tolist(), stored["feature_importances"].tolist(), strict=True))
    assert again.tobytes() == probabilities(model, values).tobytes()
    assert importances == model.importances
    with pytest.raises(DataError, match="lack"):
        FlatForest.from_arrays({})


def test_importances_carry_names_and_find_the_noise(blobs):
    values, labels = blobs
    importances = fit(values, labels).importances
    assert min(importances, key=importances.get) == "noise"
    assert sum(importances.values()) == pytest.approx(1)


def test_ignored_supervoxels_are_not_trained_on(blobs):
    values, labels = blobs
    noisy = np.vstack([values, np.full((30, 4), 7, np.float32)])
    with_ignored = fit(noisy, np.concatenate([labels, np.full(30, -1)]))
    assert probabilities(with_ignored, values).tobytes() == probabilities(fit(values, labels), values).tobytes()


def test_classes_absent_from_training_get_probability_zero(blobs):
    values, labels = blobs
    model = fit(values, np.where(labels == 1, 3, labels), n_classes=5)
    found = probabilities(model, values)
    assert found.shape == (len(values), 5)
    assert found[:, [1, 4]].max() == 0
    assert np.allclose(found.sum(axis=1), 1, atol=1e-6)
    assert (model.arrays["trained_classes"].tolist(), model.missing) == ([0, 2, 3], [1, 4])


def test_a_class_with_one_supervoxel_is_trained_on(blobs):
    values, labels = blobs
    few = np.flatnonzero((labels < 2) | (np.arange(len(labels)) == 250))
    model = fit(values[few], labels[few])
    assert model.arrays["trained_classes"].tolist() == [0, 1, 2]
    assert probabilities(model, values[[250]])[0, 2] > 0.3


def test_bad_input_is_named(blobs):
    values, _ = blobs
    with pytest.raises(DataError, match="none of 252 supervoxels is labelled"):
        fit(values, np.full(252, -1))
    with pytest.raises(DataError, match="all 252 labelled supervoxels have class 2"):
        fit(values, np.full(252, 2))


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
    parameters = ForestParameters(n_trees=20, min_samples_leaf=5)
    model = grow_forest(features, majority_labels(truth, owners, 2)[0], parameters, n_classes=2)
    labels, confidence = label_points(xyz, unseen.centroids, probabilities(model, unseen.values))
    assert np.mean(labels == unseen_truth) > 0.98
    assert 0.5 <= confidence.min() <= confidence.max() <= 1
