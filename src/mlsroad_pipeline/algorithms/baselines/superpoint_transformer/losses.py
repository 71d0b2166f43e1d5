"""Weights of classes and of sets of classes, and the loss of the network. Importing this module imports torch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mlsroad_pipeline.algorithms.baselines.superpoint_transformer.graph import SuperpointGraph


def share_superpoints(graphs: Sequence[SuperpointGraph], sets: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the share of each class in the superpoints that are labelled by single classes.

    Parameters
    ----------
    graphs : sequence of SuperpointGraph
        Labelled graphs.
    sets : ndarray of bool, shape (r, classes)
        Sets of classes of the last `r` columns of the histograms. Where no superpoint has the label of a single class,
        a set counts for each of its classes alike.

    Returns
    -------
    ndarray of float64, shape (classes,)
        The shares; their sum is 1.
    """
    n_classes = sets.shape[1]
    counts = np.zeros(n_classes + len(sets))
    for graph in graphs:
        counts += _shares(graph.levels[0].histogram).sum(axis=0)
    single = counts[:n_classes]
    if not single.any():
        single = (counts[n_classes:] / sets.sum(axis=1)) @ sets
    return single / single.sum()


def balance_classes(share: NDArray[np.float64], exponent: float) -> NDArray[np.float32]:
    """Return class weights: a power of the inverse share of superpoints, 1 on average; 0 for absent classes.

    Parameters
    ----------
    share : ndarray of float64, shape (classes,)
        Share of each class.
    exponent : float
        Exponent of the inverse share.

    Returns
    -------
    ndarray of float32, shape (classes,)
        The weights.
    """
    weights = np.where(share > 0, np.maximum(share, 1e-5) ** -exponent, 0.0)
    return (weights / (weights * share).sum()).astype(np.float32)


def balance_sets(
    share: NDArray[np.float64], class_weights: NDArray[np.float32], sets: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Return the weight of each set of classes: the mean of its classes, weighted by their shares.

    Parameters
    ----------
    share : ndarray of float64, shape (classes,)
        Share of each class.
    class_weights : ndarray of float32, shape (classes,)
        Weights of the classes.
    sets : ndarray of bool, shape (r, classes)
        The sets.

    Returns
    -------
    ndarray of float32, shape (r,)
        The weights; 0 for a set without a class that is present.
    """
    total = sets @ share
    return np.where(total > 0, sets @ (share * class_weights) / np.maximum(total, 1e-12), 0.0).astype(np.float32)


def _shares(histogram: NDArray[np.float32]) -> NDArray[np.float32]:
    return histogram / np.maximum(histogram.sum(axis=1, keepdims=True), 1.0)


def sum_losses(
    scores: Sequence[Tensor],
    histograms: Sequence[Tensor],
    column_weights: Tensor,
    level_weights: Sequence[float],
    sets: Tensor | None = None,
) -> Tensor:
    """Return the weighted sum over the levels of the cross entropies with the label histograms.

    Superpoints of level 1 count the same. Those of the levels above count as the root of their labelled points.

    Parameters
    ----------
    scores : sequence of Tensor of shape (n, classes)
        Scores of each level.
    histograms : sequence of Tensor of shape (n, classes + r)
        Labelled points of each class and set of classes; superpoints without any are left out.
    column_weights : Tensor of shape (classes + r,)
        Weights of the classes and sets.
    level_weights : sequence of float
        Weights of the levels.
    sets : Tensor of shape (r, classes), optional
        1 for the classes of each set; the probability of a set is the sum of theirs.

    Returns
    -------
    Tensor
        The loss.
    """
    total = scores[0].new_zeros(())
    for i, (score, histogram) in enumerate(zip(scores, histograms, strict=True)):
        count = histogram.sum(dim=1, keepdim=True)
        importance = (count > 0).float() if i == 0 else count.sqrt()
        target = histogram / count.clamp(min=1.0) * column_weights * importance
        logarithm = torch.log_softmax(score, dim=1)
        if sets is not None and len(sets):
            allowed = (logarithm.exp() @ sets.t()).clamp(min=1e-12).log()
            logarithm = torch.cat([logarithm, allowed], dim=1)
        entropy = -(target * logarithm).sum()
        total = total + level_weights[i] * entropy / target.sum().clamp(min=1e-6)
    return total
