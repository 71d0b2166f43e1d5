"""Fusion of labels by the F1 score of each labeller for each class (Tomic et al. 2019, section 2.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix, scores


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
