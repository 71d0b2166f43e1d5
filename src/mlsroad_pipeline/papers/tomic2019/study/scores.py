"""Experiment of Tomic et al. 2019, section 3.3: two methods scored on test set 1, fused on test set 2."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.algorithms.models.pool.log_linear import PoolParameters
from mlsroad_pipeline.papers.tomic2019.fusion.two_methods import (
    ClassPreference,
    TwoMethodFusion,
    best_labels,
    count_agreement,
)

FEATURES, IMAGES, RULE, BY_F1, POOL = "features", "images", "fusion", "fusion_by_f1", "fusion_pool"
"""The two methods, the paper's fusion, its variant that compares only F1, and the probabilistic fusion."""

LABELLINGS = (FEATURES, IMAGES, RULE, BY_F1, POOL)
ALL_POINTS, VISIBLE = "test2", "test2_visible"
"""All points of test set 2, unseen points counted as errors of the images (Tables 3 to 5), and the visible points."""

FIRST_VISIBLE = "test1_visible"
"""Visible points of test set 1, on which the paper's third conclusion compares both methods."""


@dataclass(frozen=True)
class TestSet:
    """Reference labels and predictions of both methods for the points of one part of a survey."""

    __test__ = False  # pytest must not collect it

    reference: NDArray[np.integer]  # (n,): true labels; -1 is ignored
    features: NDArray[np.floating]  # (n, classes): class probabilities of the feature-based method
    # (groups, n, classes): class probabilities of each camera; NaN where it does not see the point
    cameras: NDArray[np.floating]

    def __post_init__(self) -> None:
        n = len(self.reference)
        for name, size in (("features", len(self.features)), ("cameras", self.cameras.shape[1])):
            if size != n:
                raise DataError(f"a test set has {n} reference labels but {size} of {name}")


@dataclass(frozen=True)
class FusionScores:
    """Scores of the experiment on one survey."""

    # (classes, classes + 1): ``<labelling>.<split>`` to the confusion matrix; splits are `ALL_POINTS` and `VISIBLE`
    confusions: Mapping[str, NDArray[np.int64]]
    camera_f1: NDArray[np.float64]  # (groups, classes): F1 on test set 1 of each camera
    # (2, classes): F1 on test set 1 of both methods (Table 2), over the points that both label
    method_f1: NDArray[np.float64]
    # (k + 1, k + 1): `count_agreement` of the feature-based method and the cameras with the fusion, on test set 2
    redundancy: NDArray[np.int64]
    penalty: float  # penalty of the pool, chosen on test set 1

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the scores as arrays to store."""
        others = {name: np.asarray(getattr(self, name)) for name in _STORED}
        return {**self.confusions, **others}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> FusionScores:
        """Return the scores from stored arrays."""
        camera_f1, method_f1, redundancy, penalty = (arrays[name] for name in _STORED)
        confusions = {name: matrix for name, matrix in arrays.items() if name.partition(".")[0] in LABELLINGS}
        return cls(confusions, camera_f1, method_f1, redundancy, float(penalty))


_STORED = ("camera_f1", "method_f1", "redundancy", "penalty")


class Fused(NamedTuple):
    """Labels of test set 2 by each of `LABELLINGS`, -1 where no camera sees a point, and their scores."""

    labels: dict[str, NDArray[np.int16]]
    scores: FusionScores


def fuse_test_sets(first: TestSet, second: TestSet, *, pool: PoolParameters | None = None) -> Fused:
    """Learn the preferences of the fusion on test set 1 and fuse test set 2."""
    n_classes = first.features.shape[1]
    learned = TwoMethodFusion.fit(first.features, first.cameras, first.reference, pool=pool)
    fused = learned.fuse(second.features, second.cameras)
    labels, each = best_labels(second.features), list(best_labels(second.cameras))
    plain_cameras, plain = (replace(rule, delegate=False) for rule in (learned.cameras, learned.methods))
    by_f1 = ClassPreference.fuse(plain, [labels, plain_cameras.fuse(each)[0]])[0]
    labellings = dict(zip(LABELLINGS, (labels, fused.images, fused.rule, by_f1, fused.pool), strict=True))
    rows = {ALL_POINTS: np.arange(len(labels)), VISIBLE: np.flatnonzero(fused.images != IGNORE)}
    confusions = {
        f"{name}.{split}": confusion_matrix(second.reference[of], predicted[of], n_classes)
        for name, predicted in labellings.items()
        for split, of in rows.items()
    }
    own = best_labels(first.features), learned.cameras.fuse(list(best_labels(first.cameras)))[0]
    seen = np.flatnonzero(own[1] != IGNORE)
    confusions |= {
        f"{name}.{FIRST_VISIBLE}": confusion_matrix(first.reference[seen], predicted[seen], n_classes)
        for name, predicted in zip((FEATURES, IMAGES), own, strict=True)
    }
    redundancy = count_agreement([labels, *each], fused.rule)
    scores = FusionScores(confusions, learned.cameras.f1, learned.methods.f1, redundancy, learned.pool.penalty)
    return Fused(labellings, scores)


def method_name(labelling: str, forest: str) -> str:
    """Return the name of a labelling in the tables."""
    return {FEATURES: forest, IMAGES: "image_labels"}.get(labelling, f"{labelling}.{forest}")
