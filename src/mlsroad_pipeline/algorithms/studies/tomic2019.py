"""The experiment of Tomic et al. 2019, section 3.3: two methods scored on test set 1, fused on test set 2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.classes import IGNORE
from mlsroad_pipeline.algorithms.exceptions import DataError
from mlsroad_pipeline.algorithms.fusion.class_preference import count_agreement
from mlsroad_pipeline.algorithms.fusion.log_linear_pool import PoolParameters
from mlsroad_pipeline.algorithms.fusion.two_methods import TwoMethodFusion
from mlsroad_pipeline.algorithms.image_labels.labelling import ImageLabels
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.algorithms.metrics.scores import labelling_scores

FEATURES, IMAGES, RULE, POOL = "detrended_forest", "image_labels", "fusion", "fusion_pool"
"""Names of the two methods, of the paper's fusion, and of the probabilistic one."""


@dataclass(frozen=True)
class TestSet:
    """Points of a part of the survey, with what both methods say of them.

    Parameters
    ----------
    reference : ndarray of shape (n,), int
        True labels, -1 where they are ignored.
    labels : ndarray of shape (n,), int
        Labels of the feature-based method, -1 for none.
    confidence : ndarray of shape (n,), float
        Their probabilities.
    images : ImageLabels
        What each camera says.
    """

    __test__ = False  # no test, for pytest

    reference: NDArray[np.integer]
    labels: NDArray[np.integer]
    confidence: NDArray[np.floating]
    images: ImageLabels

    def __post_init__(self) -> None:
        n = len(self.reference)
        for name, size in (
            ("labels", len(self.labels)), ("confidence", len(self.confidence)),
            ("images", self.images.n_images.shape[1]),
        ):  # fmt: skip
            if size != n:
                raise DataError(f"a test set has {n} reference labels but {size} of {name}")


@dataclass(frozen=True)
class FusionStudy:
    """What the experiment gave.

    Parameters
    ----------
    scores : pandas.DataFrame
        The table of scores of `labelling_scores`: methods `FEATURES`, `IMAGES`, `RULE` and `POOL`; splits
        ``test2`` (all points, unseen ones wrong for the image method: Tables 3 to 5) and ``test2_visible``.
    camera_f1 : pandas.DataFrame
        F1 on test set 1 of each camera (row) and class (column).
    method_f1 : pandas.DataFrame
        F1 on test set 1 of both methods (rows; Table 2), over the points that both label.
    redundancy : ndarray of shape (k + 1, k + 1), int64
        `count_agreement` of the feature-based method and the cameras with the fusion, on test set 2.
    fused, pooled : ndarray of shape (n,), int16
        Labels of test set 2 by both fusions.
    """

    scores: pd.DataFrame
    camera_f1: pd.DataFrame
    method_f1: pd.DataFrame
    redundancy: NDArray[np.int64]
    fused: NDArray[np.int16]
    pooled: NDArray[np.int16]


def fuse_test_sets(
    first: TestSet, second: TestSet, *, classes: Sequence[str], pool: PoolParameters | None = None
) -> FusionStudy:
    """Learn on test set 1 which camera and which method to believe, and fuse test set 2.

    Parameters
    ----------
    first, second : TestSet
        Test sets 1 and 2; nothing of the second but its labels is used before it is scored.
    classes : sequence of str
        Names of the classes.
    pool : PoolParameters, optional
        Of the probabilistic fusion.

    Returns
    -------
    FusionStudy
        Scores, and what was learned.

    Raises
    ------
    DataError
        If the test sets have other cameras, or no point of test set 1 is labelled.
    """
    if first.images.groups != second.images.groups:
        raise DataError(f"test set 1 has cameras {first.images.groups}, test set 2 {second.images.groups}")
    c = len(classes)
    learned = TwoMethodFusion.fit(
        first.labels, first.confidence, first.images.probabilities, first.reference, pool=pool
    )
    found = learned.fuse(second.labels, second.confidence, second.images.probabilities)
    answers = {FEATURES: second.labels, IMAGES: found.images, RULE: found.rule, POOL: found.pool}
    visible = found.images != IGNORE
    tables = [
        labelling_scores(
            confusion_matrix(second.reference[rows], given[rows], c), method=method, split=split, classes=classes
        )
        for split, rows in (("test2", slice(None)), ("test2_visible", visible))
        for method, given in answers.items()
    ]
    return FusionStudy(
        pd.concat(tables, ignore_index=True),
        pd.DataFrame(learned.cameras.f1, index=list(first.images.groups), columns=list(classes)),
        pd.DataFrame(learned.methods.f1, index=[FEATURES, IMAGES], columns=list(classes)),
        count_agreement([second.labels, *second.images.labels], found.rule),
        found.rule,
        found.pool,
    )
