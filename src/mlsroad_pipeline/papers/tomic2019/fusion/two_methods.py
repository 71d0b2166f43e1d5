"""Fusion of a feature-based method and of cameras by the class preference of the paper and by the log-linear pool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix, scores
from mlsroad_pipeline.algorithms.models.pool.log_linear import LogLinearPool, PoolParameters


@dataclass(frozen=True)
class ClassPreference:
    """Preferred labeller of each class.

    Every labeller is scored by F1 on test set 1, over the points that it labels; the best one is preferred for the
    class. A label of the preferred labeller of its class outranks other labels.
    """

    f1: NDArray[np.float64]  # F1 on test set 1; 0 where it is not defined
    # Whether preferred labellers outrank others. False compares F1 alone, a reading of the paper that its Table 5
    # contradicts.
    delegate: bool = True

    @classmethod
    def fit(
        cls, labels: Sequence[ArrayLike], reference: ArrayLike, *, n_classes: int, delegate: bool = True
    ) -> ClassPreference:
        """Score labellers on test set 1."""
        if not len(labels):
            raise DataError("fusion needs at least one labeller")
        truth = np.asarray(reference)
        rows = []
        for mine in map(np.asarray, labels):
            if mine.shape != truth.shape:
                raise DataError(f"labels must have shape {truth.shape} as the reference, got {mine.shape}")
            known = mine != IGNORE
            rows.append(np.nan_to_num(scores(confusion_matrix(truth[known], mine[known], n_classes)).f1))
        return cls(np.array(rows), delegate)

    @property
    def preferred(self) -> NDArray[np.int64]:
        """The labeller with the highest F1 for each class, of shape (classes,); ties go to the first."""
        return self.f1.argmax(axis=0)

    def fuse(self, labels: Sequence[ArrayLike]) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
        """Fuse the labels of all labellers."""
        table = stack_labels(labels, *self.f1.shape)
        named = np.maximum(table, 0)
        score = np.take_along_axis(self.f1, named, axis=1)
        if self.delegate:  # F1 is at most 1
            score += 2.0 * (self.preferred[named] == np.arange(len(table))[:, None])
        score[table == IGNORE] = -1.0
        best = score.argmax(axis=0)
        label = np.take_along_axis(table, best[None], axis=0)[0]
        return label.astype(np.int16), np.where(label == IGNORE, -1, best).astype(np.int16)


def stack_labels(labels: Sequence[ArrayLike], n_labellers: int, n_classes: int) -> NDArray[np.int64]:
    """Validate the labels of several labellers and return them as rows."""
    lengths = sorted({len(np.asarray(mine)) for mine in labels})
    if len(labels) != n_labellers or len(lengths) != 1:
        raise DataError(f"expected labels of {n_labellers} labellers of one length, got {len(labels)} of {lengths}")
    table = np.stack([np.asarray(mine) for mine in labels]).astype(np.int64)
    if table.size and not -1 <= int(table.min()) <= int(table.max()) < n_classes:
        raise DataError(f"labels must be in -1..{n_classes - 1}, got {table.min()}..{table.max()}")
    return table


def count_agreement(labels: Sequence[ArrayLike], fused: ArrayLike) -> NDArray[np.int64]:
    """Count points by the numbers of labellers and of labellers that agree with the fusion (redundancy)."""
    final = np.asarray(fused)
    table = stack_labels(labels, len(labels), int(np.iinfo(np.int16).max))
    if table.shape[1] != len(final):
        raise DataError(f"{len(final)} fused labels for {table.shape[1]} points")
    size = len(labels) + 1
    labellers = (table != IGNORE).sum(axis=0)
    agree = ((table == final) & (table != IGNORE)).sum(axis=0)
    counts: NDArray[np.int64] = np.bincount(labellers * size + agree, minlength=size * size).reshape(size, size)
    return counts


def spread_confidence(
    labels: NDArray[np.integer], confidence: NDArray[np.floating], n_classes: int
) -> NDArray[np.float32]:
    """Return the probabilities of all classes of a labeller that gives the best class and its probability.

    The rest is split evenly among the other classes; points without a label have NaN.
    """
    rest = (1 - confidence.astype(np.float32)) / np.float32(n_classes - 1)
    out = np.repeat(rest[:, None], n_classes, axis=1)
    known = labels != IGNORE
    out[known, labels[known]] = confidence[known]
    out[~known] = np.nan
    return out


def best_labels(probabilities: NDArray[np.floating]) -> NDArray[np.int16]:
    """Return the most probable class, the lowest of equally probable ones; -1 for rows of NaN."""
    best = np.nan_to_num(probabilities).argmax(axis=-1)
    return np.where(np.isnan(probabilities[..., 0]), IGNORE, best).astype(np.int16)


@dataclass(frozen=True)
class FusedLabels:
    """Labels chosen among the cameras (-1: unseen), by class preference, by the pool, and its probabilities."""

    images: NDArray[np.int16]
    rule: NDArray[np.int16]
    pool: NDArray[np.int16]
    probabilities: NDArray[np.float64]


@dataclass(frozen=True)
class TwoMethodFusion:
    """Fusion of two methods, fitted on test set 1 (Tomic et al. 2019, sections 2.3 and 3.3).

    `cameras` is the preference among the cameras, `methods` that between features (first) and images; the pool is of
    the features and all cameras.
    """

    cameras: ClassPreference
    methods: ClassPreference
    pool: LogLinearPool

    @classmethod
    def fit(
        cls, features: NDArray[np.floating], cameras: NDArray[np.floating], reference: NDArray[np.integer], *,
        pool: PoolParameters | None = None, delegate: bool = True,
    ) -> TwoMethodFusion:  # fmt: skip
        """Fit preferences and pool on test set 1, whose points are in the order of the road.

        Class probabilities are NaN where a method has no label, or a camera does not see the point; points labelled -1
        are ignored.
        """
        n_classes = cameras.shape[2]
        labels, by_camera = best_labels(features), best_labels(cameras)
        among = ClassPreference.fit(list(by_camera), reference, n_classes=n_classes, delegate=delegate)
        images, _ = among.fuse(list(by_camera))
        both = (images != IGNORE) & (labels != IGNORE)
        methods = ClassPreference.fit(
            [labels[both], images[both]], reference[both], n_classes=n_classes, delegate=delegate
        )
        learned = LogLinearPool.fit([features, *cameras], reference, parameters=pool)
        return cls(among, methods, learned)

    def fuse(self, features: NDArray[np.floating], cameras: NDArray[np.floating]) -> FusedLabels:
        """Fuse the class probabilities of the features and of the cameras; NaN as in `fit`."""
        images, _ = self.cameras.fuse(list(best_labels(cameras)))
        rule, _ = self.methods.fuse([best_labels(features), images])
        probabilities = self.pool.predict_proba([features, *cameras])
        return FusedLabels(images, rule, probabilities.argmax(axis=1).astype(np.int16), probabilities)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the fitted state as arrays, for files without code."""
        return {
            "camera_f1": self.cameras.f1,
            "method_f1": self.methods.f1,
            "delegate": np.array([self.methods.delegate]),
            "bias": self.pool.bias,
            "weights": self.pool.weights,
            "offsets": self.pool.offsets,
            "floor": np.array([self.pool.floor]),
            "penalty": np.array([self.pool.penalty]),
        }

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray]) -> TwoMethodFusion:
        """Rebuild a fusion from the arrays of `to_arrays`."""
        pool = LogLinearPool(
            arrays["bias"], arrays["weights"], arrays["offsets"], float(arrays["floor"][0]), float(arrays["penalty"][0])
        )
        delegate = bool(arrays["delegate"][0])
        among, methods = (ClassPreference(arrays[name], delegate) for name in ("camera_f1", "method_f1"))
        return cls(among, methods, pool)
