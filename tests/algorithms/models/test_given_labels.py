"""Labels that a survey comes with: as a method, pooled with a model, and kept."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.given_labels.labeller import (
    CONFIDENCE,
    LABEL,
    PROBABILITIES,
    given_bundle,
    label_cloud_softly,
    pool_with_given,
    with_kept_labels,
)
from mlsroad_pipeline.algorithms.models.labelling import SoftLabels, label_softly

SCHEME = ClassScheme("three", ("ground", "pole", "tree"), (("road",), ("post",), ("tree",)), (), (2, 64, 5))


def cloud(n, **columns):
    return PointCloud(np.zeros((n, 3), np.float32), columns)


def test_labels_and_probabilities_are_taken_as_they_are():
    bundle = given_bundle(SCHEME)
    p = np.array([[0.2, 0.7, 0.1], [np.nan] * 3, [0.6, 0.1, 0.3]], np.float32)
    soft = label_softly(bundle, cloud(3, **{PROBABILITIES: p}))
    assert soft.labels.tolist() == [1, -1, 0] and soft.owner.tolist() == [0, -1, 2]
    assert soft.confidence.tolist() == pytest.approx([0.7, 0, 0.6])
    label, sure = np.array([2, -1], np.int16), np.array([0.9, 0], np.float32)
    hard = label_softly(bundle, cloud(2, **{LABEL: label, CONFIDENCE: sure}))
    assert hard.labels.tolist() == [2, -1] and hard.probabilities is None
    assert label_softly(bundle, cloud(2)).labels.tolist() == [-1, -1]


def test_a_labelled_file_gives_the_labels_that_were_written():
    codes = np.array([64, 1, 5, 2], np.uint8)
    soft = label_cloud_softly(
        cloud(4, classification=codes, confidence=np.full(4, 0.8, np.float32)), given_bundle(SCHEME)
    )
    assert soft.labels.tolist() == [1, -1, 2, 0]
    assert soft.confidence.tolist() == pytest.approx([0.8, 0, 0.8, 0.8])


def test_a_file_with_other_codes_is_read_by_them():
    bundle = given_bundle(SCHEME, np.array([64, 65, 66], np.uint8))
    codes = np.array([64, 66, 2], np.uint8)
    assert label_cloud_softly(
        cloud(3, classification=codes, confidence=np.ones(3, np.float32)), bundle
    ).labels.tolist() == [0, 2, -1]


def test_a_pool_is_the_normalised_product_of_powers():
    own = np.array([[0.5, 0.3, 0.2]], np.float32)
    given = np.array([[0.1, 0.8, 0.1], [np.nan] * 3, [0.1, 0.8, 0.1]], np.float32)
    soft = SoftLabels(np.array([0, 0, -1], np.int16), np.full(3, 0.5, np.float32), own, np.array([0, 0, -1]))
    pooled = pool_with_given(soft, cloud(3, **{PROBABILITIES: given}), 0.25)
    expected = own[0] ** 0.75 * given[0] ** 0.25
    assert pooled.probabilities[0] == pytest.approx(expected / expected.sum(), rel=1e-5)
    assert pooled.probabilities[1] == pytest.approx(own[0]) and pooled.probabilities[2] == pytest.approx(given[2])
    by_number = pool_with_given(
        soft, cloud(3, **{LABEL: np.array([2, 2, -1], np.int16), CONFIDENCE: np.ones(3, np.float32)}), 0.9
    )
    assert by_number.labels.tolist() == [2, 2, -1]
    with pytest.raises(ParameterError, match=r"label\.given\.weight needs a model with class probabilities"):
        pool_with_given(SoftLabels(soft.labels, soft.confidence), cloud(3, **{PROBABILITIES: given}), 0.5)


def test_kept_labels_are_certain_and_leave_the_others():
    own = np.array([[0.5, 0.3, 0.2]], np.float32)
    soft = SoftLabels(np.array([0, 0, 0], np.int16), np.full(3, 0.5, np.float32), own, np.zeros(3, np.int32))
    kept = with_kept_labels(soft, np.array([True, True, False]), np.array([2, -1, -1], np.int16), 3)
    assert kept.labels.tolist() == [2, -1, 0] and kept.confidence.tolist() == [1, 1, 0.5]
    assert kept.owner[1] == -1 and kept.probabilities[kept.owner[0]].tolist() == [0, 0, 1]
    assert kept.probabilities[kept.owner[2]] == pytest.approx(own[0])
