"""One label out of several, by how good each labeller was for the class that it names (Tomic et al. 2019, 2.3)."""

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
    """Which labeller is believed for which class.

    Every labeller is scored by F1 on test set 1, over the points that it labels, and the best one for a class delivers
    its labels: a label from the labeller that is preferred for its class beats one from a labeller that is not. Of two
    labels that are left, both preferred or neither, the one with the higher F1 wins. Ties go to the first labeller. A
    point that only some labellers label takes the label of those; so the rule serves both steps of the paper, the
    choice among cameras and that between the methods.

    Parameters
    ----------
    f1 : ndarray of shape (labellers, classes), float64
        F1 on test set 1; 0 where it is not defined.
    delegate : bool, default True
        Whether preferred labellers go before others. False compares F1 alone, a reading of the paper that its Table 5
        contradicts.

    References
    ----------
    .. [1] D. Tomic et al., "Fusion of feature based and deep learning methods for classification of MMS point clouds",
       ISPRS Archives, 2019, sections 2.3 and 3.3, Tables 2 and 5.
    """

    f1: NDArray[np.float64]
    delegate: bool = True

    @classmethod
    def fit(
        cls, labels: Sequence[ArrayLike], reference: ArrayLike, *, n_classes: int, delegate: bool = True
    ) -> ClassPreference:
        """Score labellers on test set 1.

        Parameters
        ----------
        labels : sequence of array-like of int, each of shape (n,)
            Labels of each labeller, -1 where it has none.
        reference : array-like of int, shape (n,)
            True labels; points labelled -1 are ignored.
        n_classes : int
            Number of classes.
        delegate : bool, default True
            Whether preferred labellers go before others.

        Returns
        -------
        ClassPreference
            The rule.

        Raises
        ------
        DataError
            If there is no labeller, lengths differ, or a label is outside -1 to ``n_classes - 1``.
        ParameterError
            If `n_classes` is below 1.
        """
        if not len(labels):
            raise DataError("fusion needs at least one labeller")
        truth = np.asarray(reference)
        rows = []
        for given in map(np.asarray, labels):
            if given.shape != truth.shape:
                raise DataError(f"labels must have shape {truth.shape} as the reference, got {given.shape}")
            known = given != IGNORE
            rows.append(np.nan_to_num(scores(confusion_matrix(truth[known], given[known], n_classes)).f1))
        return cls(np.array(rows), delegate)

    @property
    def preferred(self) -> NDArray[np.int64]:
        """The labeller with the highest F1 for each class, of shape (classes,); ties go to the first."""
        return self.f1.argmax(axis=0)

    def fuse(self, labels: Sequence[ArrayLike]) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
        """Make one label of those of all labellers.

        Parameters
        ----------
        labels : sequence of array-like of int, each of shape (n,)
            Labels of each labeller, in the order in which they were scored; -1 where it has none.

        Returns
        -------
        label : ndarray of shape (n,), int16
            The labels; -1 where no labeller has one.
        labeller : ndarray of shape (n,), int16
            Whose label it is, of equal ones the first best; -1 where there is none.

        Raises
        ------
        DataError
            If the number of labellers or their lengths differ, or a label is outside -1 to ``classes - 1``.
        """
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
    """Return labels of several labellers as rows, checked.

    Parameters
    ----------
    labels : sequence of array-like of int, each of shape (n,)
        Labels, -1 for none.
    n_labellers, n_classes : int
        What is expected.

    Returns
    -------
    ndarray of shape (n_labellers, n), int64
        The labels.

    Raises
    ------
    DataError
        If the number of labellers or their lengths differ, or a label is outside -1 to ``n_classes - 1``.
    """
    lengths = sorted({len(np.asarray(given)) for given in labels})
    if len(labels) != n_labellers or len(lengths) != 1:
        raise DataError(f"expected labels of {n_labellers} labellers of one length, got {len(labels)} of {lengths}")
    table = np.stack([np.asarray(given) for given in labels]).astype(np.int64)
    if table.size and not -1 <= int(table.min()) <= int(table.max()) < n_classes:
        raise DataError(f"labels must be in -1..{n_classes - 1}, got {table.min()}..{table.max()}")
    return table


def count_agreement(labels: Sequence[ArrayLike], fused: ArrayLike) -> NDArray[np.int64]:
    """Count how many labellers label each point, and how many of them say what the fusion says: its redundancy.

    Parameters
    ----------
    labels : sequence of array-like of int, each of shape (n,)
        Labels of each labeller, -1 where it has none.
    fused : array-like of int, shape (n,)
        The labels of the fusion.

    Returns
    -------
    ndarray of shape (labellers + 1, labellers + 1), int64
        Points by the number of labellers that label them (row) and the number that agree with the fusion (column).

    Raises
    ------
    DataError
        If lengths differ.
    """
    final = np.asarray(fused)
    table = stack_labels(labels, len(labels), int(np.iinfo(np.int16).max))
    if table.shape[1] != len(final):
        raise DataError(f"{len(final)} fused labels for {table.shape[1]} points")
    size = len(labels) + 1
    given = (table != IGNORE).sum(axis=0)
    agree = ((table == final) & (table != IGNORE)).sum(axis=0)
    counts: NDArray[np.int64] = np.bincount(given * size + agree, minlength=size * size).reshape(size, size)
    return counts
