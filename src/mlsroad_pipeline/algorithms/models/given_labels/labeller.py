"""Labels that a survey comes with, as a method: they are taken as they are, or pooled with those of a model."""

from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.labels import unlabelled
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import SoftLabels

SLUG = "given_labels"

LABEL, CONFIDENCE, PROBABILITIES = "given_label", "given_confidence", "given_probabilities"
"""Columns of a scene: class of the scheme or -1, its confidence, and class probabilities or NaN."""

KEPT_CONFIDENCE = 1.0
"""Confidence of a kept class."""
NUMBER_CONFIDENCE = 0.9
"""Confidence of a prediction that is a class number alone, and its probability where it is pooled."""
FLOOR = 1e-4
"""Least probability of a class in a pool."""


def given_bundle(scheme: ClassScheme, codes: NDArray[np.uint8] | None = None) -> ModelBundle:
    """Return the model without weights that takes the labels of the columns.

    `codes` are those of the classes in labelled files; None is those of the scheme.
    """
    written = (scheme.codes() if codes is None else codes).tolist()
    metadata = {"classes": list(scheme.classes), "scheme": asdict(scheme), "attributes": [], "codes": written}
    return ModelBundle(SLUG, {}, metadata)


def label_cloud_softly(cloud: PointCloud, bundle: ModelBundle) -> SoftLabels:
    """Return the labels of a cloud: of its columns, else of a labelled file, else none."""
    if PROBABILITIES in cloud:
        return _most_probable(cloud[PROBABILITIES])
    if LABEL in cloud:
        return SoftLabels(cloud[LABEL], cloud[CONFIDENCE])
    if "classification" in cloud and "confidence" in cloud:  # a labelled file, which `learn` reads
        label = np.full(256, IGNORE, dtype=np.int16)
        codes = np.array(bundle.metadata["codes"])
        label[codes[::-1]] = np.arange(len(codes), dtype=np.int16)[::-1]
        found = label[cloud["classification"].astype(np.uint8)]
        return SoftLabels(found, np.where(found < 0, 0, cloud["confidence"]).astype(np.float32))
    return SoftLabels(*unlabelled(len(cloud)))


def _most_probable(probabilities: NDArray[np.float32]) -> SoftLabels:
    """Return the labels of class probabilities, one row a point; rows of NaN are points without a class."""
    known = ~np.isnan(probabilities[:, 0])
    filled = np.where(known[:, None], probabilities, np.float32(0))
    label = np.where(known, filled.argmax(axis=1), IGNORE).astype(np.int16)
    owner = np.where(known, np.arange(len(label)), IGNORE).astype(np.int32)
    return SoftLabels(label, filled.max(axis=1), filled, owner)


def pool_with_given(soft: SoftLabels, cloud: PointCloud, weight: float) -> SoftLabels:
    """Return the log-linear pool of the labels of a model and of the columns; `weight` is that of the columns.

    A point without a class in one of them has the probabilities of the other.
    """
    if soft.probabilities is None or soft.owner is None:
        raise ParameterError("label.given.weight needs a model with class probabilities: pool, boosted_trees")
    n_classes = soft.probabilities.shape[1]
    if PROBABILITIES in cloud:
        given = cloud[PROBABILITIES]
    else:
        label = cloud[LABEL]
        rows = np.full((n_classes + 1, n_classes), (1 - NUMBER_CONFIDENCE) / max(n_classes - 1, 1), dtype=np.float32)
        np.fill_diagonal(rows, NUMBER_CONFIDENCE)
        rows[-1] = np.nan
        given = rows[label]
    own = np.append(soft.probabilities, np.full((1, n_classes), np.nan, np.float32), axis=0)[soft.owner]
    pooled = np.exp((1 - weight) * np.log(np.maximum(own, FLOOR)) + weight * np.log(np.maximum(given, FLOOR)))
    pooled /= pooled.sum(axis=1, keepdims=True)
    no_given = np.isnan(given).any(axis=1, keepdims=True)
    no_own = np.isnan(own).any(axis=1, keepdims=True)
    return _most_probable(np.where(no_given, own, np.where(no_own, given, pooled)).astype(np.float32))


def with_kept_labels(soft: SoftLabels, kept: NDArray[np.bool_], label: NDArray[np.int16], n_classes: int) -> SoftLabels:
    """Return labels in which points of `kept` have the class of `label` with certainty; -1 is no class."""
    labels = np.where(kept, label, soft.labels).astype(np.int16)
    confidence = np.where(kept, np.float32(KEPT_CONFIDENCE), soft.confidence)
    if soft.probabilities is None or soft.owner is None:
        return SoftLabels(labels, confidence)
    rows = np.concatenate([soft.probabilities, np.eye(n_classes, dtype=np.float32)])
    own = np.where(label < 0, IGNORE, len(soft.probabilities) + label.astype(np.int32))
    return SoftLabels(labels, confidence, rows, np.where(kept, own, soft.owner).astype(np.int32))
