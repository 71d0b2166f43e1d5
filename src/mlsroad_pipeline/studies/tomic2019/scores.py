"""The experiment of Tomic et al. 2019, section 3.3: two methods scored on test set 1, fused on test set 2."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.fusion.class_preference import ClassPreference, count_agreement
from mlsroad_pipeline.algorithms.fusion.log_linear_pool import PoolParameters
from mlsroad_pipeline.algorithms.fusion.two_methods import TwoMethodFusion, best_labels
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix

FEATURES, IMAGES, RULE, BY_F1, POOL = "features", "images", "fusion", "fusion_by_f1", "fusion_pool"
"""The two methods, the paper's fusion, the reading of it that compares F1 alone, and the probabilistic fusion."""

ANSWERS = (FEATURES, IMAGES, RULE, BY_F1, POOL)
ALL_POINTS, VISIBLE = "test2", "test2_visible"
"""Test set 2 whole, unseen points wrong for the images (Tables 3 to 5), and the points that a camera sees."""


@dataclass(frozen=True)
class TestSet:
    """Points of a part of the survey, with what both methods say of them.

    Parameters
    ----------
    reference : ndarray of shape (n,), int
        True labels, -1 where they are ignored.
    features : ndarray of shape (n, classes), float
        Probabilities by the feature-based method.
    cameras : ndarray of shape (groups, n, classes), float
        Probabilities by each camera; NaN where it does not see the point.
    """

    __test__ = False  # no test, for pytest

    reference: NDArray[np.integer]
    features: NDArray[np.floating]
    cameras: NDArray[np.floating]

    def __post_init__(self) -> None:
        n = len(self.reference)
        for name, size in (("features", len(self.features)), ("cameras", self.cameras.shape[1])):
            if size != n:
                raise DataError(f"a test set has {n} reference labels but {size} of {name}")


@dataclass(frozen=True)
class FusionStudy:
    """What the experiment gave on one survey.

    Parameters
    ----------
    answers : dict of str to ndarray of shape (n,), int16
        Labels of test set 2 by each of `ANSWERS`; -1 where no camera sees a point.
    confusions : dict of str to ndarray of shape (classes, classes + 1), int64
        ``<answer>.<split>`` to the confusion on `ALL_POINTS` and `VISIBLE`.
    camera_f1 : ndarray of shape (groups, classes), float64
        F1 on test set 1 of each camera.
    method_f1 : ndarray of shape (2, classes), float64
        F1 on test set 1 of both methods (Table 2), over the points that both label.
    redundancy : ndarray of shape (k + 1, k + 1), int64
        `count_agreement` of the feature-based method and the cameras with the fusion, on test set 2.
    penalty : float
        Of the pool, as chosen on test set 1.
    """

    answers: dict[str, NDArray[np.int16]]
    confusions: dict[str, NDArray[np.int64]]
    camera_f1: NDArray[np.float64]
    method_f1: NDArray[np.float64]
    redundancy: NDArray[np.int64]
    penalty: float


def fuse_test_sets(first: TestSet, second: TestSet, *, pool: PoolParameters | None = None) -> FusionStudy:
    """Learn on test set 1 which camera and which method to believe, and fuse test set 2."""
    n_classes = first.features.shape[1]
    learned = TwoMethodFusion.fit(first.features, first.cameras, first.reference, pool=pool)
    found = learned.fuse(second.features, second.cameras)
    labels, each = best_labels(second.features), list(best_labels(second.cameras))
    plain_cameras, plain = (replace(rule, delegate=False) for rule in (learned.cameras, learned.methods))
    by_f1 = ClassPreference.fuse(plain, [labels, plain_cameras.fuse(each)[0]])[0]
    answers = dict(zip(ANSWERS, (labels, found.images, found.rule, by_f1, found.pool), strict=True))
    rows = {ALL_POINTS: np.arange(len(labels)), VISIBLE: np.flatnonzero(found.images != IGNORE)}
    confusions = {
        f"{name}.{split}": confusion_matrix(second.reference[of], given[of], n_classes)
        for name, given in answers.items()
        for split, of in rows.items()
    }
    redundancy = count_agreement([labels, *each], found.rule)
    return FusionStudy(
        answers, confusions, learned.cameras.f1, learned.methods.f1, redundancy, learned.pool.penalty
    )  # fmt: skip
