import numpy as np
import pytest

from mlsroad_pipeline.algorithms.exceptions import DataError
from mlsroad_pipeline.algorithms.fusion.two_methods import spread_confidence
from mlsroad_pipeline.algorithms.image_labels.labelling import ImageLabels
from mlsroad_pipeline.algorithms.studies.tomic2019 import (
    FEATURES,
    IMAGES,
    POOL,
    RULE,
    TestSet,
    fuse_test_sets,
)

CLASSES = ["a", "b", "c"]


def drawn(rng, truth, right):
    """Labels that are right with a probability per class, otherwise the next class."""
    return np.where(rng.random(len(truth)) < np.asarray(right)[truth], truth, (truth + 1) % 3)


def planted(rng, n=12_000):
    """The features know class a, camera x knows b, camera y knows c; a third of the points is in no image."""
    truth = rng.choice(3, n, p=[0.5, 0.3, 0.2])
    labels = drawn(rng, truth, [0.95, 0.6, 0.5])
    cameras = np.stack([drawn(rng, truth, right) for right in ([0.8, 0.95, 0.6], [0.7, 0.6, 0.95])])
    seen = np.stack([rng.random(n) < 0.8, rng.random(n) < 0.8]) & (rng.random(n) < 0.7)
    probabilities = np.full((2, n, 3), 0.1, dtype=np.float32)
    np.put_along_axis(probabilities, cameras[:, :, None], np.float32(0.8), axis=2)
    probabilities[~seen] = np.nan
    return TestSet(truth, labels, np.full(n, 0.8), ImageLabels(("x", "y"), probabilities, seen.astype(np.int16)))


def figure(study, method, split, metric="overall_accuracy"):
    table = study.scores
    rows = (
        (table["method"] == method)
        & (table["split"] == split)
        & (table["metric"] == metric)
        & (table["class"] == "all")
    )
    return float(table.loc[rows, "value"].iloc[0])


def test_what_each_knows_best_is_believed_and_the_fusion_is_better_than_either(rng):
    study = fuse_test_sets(planted(rng), planted(rng), classes=CLASSES)
    assert study.camera_f1[["b", "c"]].idxmax().tolist() == ["x", "y"]
    accuracy = {method: figure(study, method, "test2") for method in (FEATURES, IMAGES, RULE, POOL)}
    assert accuracy[POOL] > accuracy[RULE] > accuracy[FEATURES] + 0.03 > accuracy[IMAGES]
    # Unseen points are wrong for the images over all points, and not counted over visible ones.
    assert figure(study, IMAGES, "test2_visible") > accuracy[IMAGES] + 0.2
    assert figure(study, RULE, "test2_visible") > figure(study, FEATURES, "test2_visible")


def test_points_in_no_image_keep_the_label_of_the_features(rng):
    second = planted(rng)
    study = fuse_test_sets(planted(rng), second, classes=CLASSES)
    unseen = (second.images.n_images == 0).all(axis=0)
    assert unseen.any() and np.array_equal(study.fused[unseen], second.labels[unseen])
    assert study.redundancy.sum() == len(second.reference) and study.redundancy[1].sum() == unseen.sum()


def test_the_reference_of_test_set_2_changes_no_label(rng):
    first, second = planted(rng), planted(rng)
    blind = TestSet(np.roll(second.reference, 1), second.labels, second.confidence, second.images)
    one, other = (fuse_test_sets(first, part, classes=CLASSES) for part in (second, blind))
    assert np.array_equal(one.fused, other.fused) and np.array_equal(one.pooled, other.pooled)


def test_confidences_become_probabilities():
    out = spread_confidence(np.array([1, -1]), np.array([0.8, 0.0]), 3)
    np.testing.assert_allclose(out[0], [0.1, 0.8, 0.1], atol=1e-6)
    assert np.isnan(out[1]).all()


def test_sets_that_do_not_fit_are_named(rng):
    first = planted(rng, 100)
    with pytest.raises(DataError, match="100 reference labels but 99 of labels"):
        TestSet(first.reference, first.labels[1:], first.confidence, first.images)
    other = ImageLabels(("x", "z"), first.images.probabilities, first.images.n_images)
    with pytest.raises(DataError, match=r"test set 1 has cameras \('x', 'y'\), test set 2 \('x', 'z'\)"):
        fuse_test_sets(first, TestSet(first.reference, first.labels, first.confidence, other), classes=CLASSES)
