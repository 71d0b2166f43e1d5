"""Alpha-expansion by graph cuts on general graphs (Boykov, Veksler and Zabih 2001, section 5).

The energy of a labelling y is

    E(y) = sum_i unary[i, y_i] + sum_e weights[e] * label_costs[y_i, y_j] - sum_e agreement[e, k] * [y_i = y_j = k]

with the ends i and j of edge e. An expansion of label alpha lets every node keep its label or take alpha; the best of
all these 2**n labellings is found at once, as a minimum cut. Labels take turns until none of them lowers the energy.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.algorithms.energy.binary_cut import CutGraph
from mlsroad_pipeline.algorithms.energy.pairwise_energy import PairwiseEnergy

_LEAST_GAIN = 1e-10
"""Share of the energy's size by which a move must lower it: below it lies the rounding of the sums."""


def initial_labels(unary: NDArray[np.float64], initial: ArrayLike | None) -> NDArray[np.int32]:
    """Return the labels to start from: those given, or each node's cheapest.

    Parameters
    ----------
    unary : ndarray of float64, shape (n, l)
        Unary terms.
    initial : array-like of int, shape (n,), optional
        Labels to start from.

    Returns
    -------
    ndarray of int32, shape (n,)
        A new array.

    Raises
    ------
    DataError
        If `initial` has another shape, is not of integers, or names a label that does not exist.
    """
    if initial is None:
        return unary.argmin(axis=1).astype(np.int32)
    labels = np.asarray(initial)
    if labels.shape != (len(unary),) or (len(labels) and not np.issubdtype(labels.dtype, np.integer)):
        raise DataError(f"initial must hold {len(unary)} integers, got {labels.dtype} {labels.shape}")
    if len(labels) and not 0 <= labels.min() <= labels.max() < unary.shape[1]:
        raise DataError(f"initial has labels from {labels.min()} to {labels.max()}, but there are {unary.shape[1]}")
    return labels.astype(np.int32)


def expand_in_turn(
    labels: NDArray[np.int32],
    *,
    n_labels: int,
    max_cycles: int,
    energy: Callable[[NDArray[np.int32]], float],
    move: Callable[[NDArray[np.int32], int], NDArray[np.bool_]],
) -> tuple[NDArray[np.int32], float]:
    """Expand the labels in turn until no expansion lowers the energy.

    Parameters
    ----------
    labels : ndarray of int32, shape (n,)
        Labels to start from.
    n_labels : int
        The number of labels.
    max_cycles : int
        How often each label may have its turn.
    energy : callable
        Labelling to energy.
    move : callable
        Labelling and alpha to the nodes that take alpha in the best expansion.

    Returns
    -------
    tuple of (ndarray of int32, float)
        The last labelling and its energy.

    Raises
    ------
    ParameterError
        If `max_cycles` is below 1.
    """
    check_at_least(max_cycles, 1, "max_cycles")
    lowest = energy(labels)
    idle = 0  # labels since the last that lowered the energy, which itself need not be tried again
    for turn in range(max_cycles * n_labels):
        alpha = turn % n_labels
        tried = np.where(move(labels, alpha), np.int32(alpha), labels)
        cost = energy(tried)
        if cost < lowest - _LEAST_GAIN * max(abs(lowest), 1.0):
            labels, lowest, idle = tried, cost, 1
        else:
            idle += 1
        if idle >= n_labels:
            break
    return labels, lowest


def minimize(
    unary: ArrayLike,
    edges: ArrayLike,
    weights: ArrayLike,
    *,
    label_costs: ArrayLike | None = None,
    agreement: ArrayLike | None = None,
    initial: ArrayLike | None = None,
    max_cycles: int = 100,
) -> tuple[NDArray[np.int32], float]:
    """Minimise an energy of unary terms and pairs by alpha-expansion.

    No expansion of any label lowers the energy of the result any further. With two labels that is the global minimum;
    with more it is at most twice the ratio of the largest to the smallest label cost away from it (Boykov et al. 2001,
    Theorem 6.1, for energies without negative terms). The result does not depend on anything but the arguments.

    Parameters
    ----------
    unary : array-like of shape (n, l)
        What node i pays for label k; any finite numbers.
    edges : array-like of int, shape (e, 2)
        Pairs of different nodes, each undirected edge once. An edge that is listed twice counts twice.
    weights : array-like of shape (e,) or a number
        Factor of the label costs of each edge, not negative. Larger weights make smoother labellings.
    label_costs : array-like of shape (l, l), optional
        What two labels cost at the ends of an edge of weight 1: a metric. By default 1 for different labels, the Potts
        model.
    agreement : array-like of shape (e, l), optional
        What an edge gains where both of its ends have label k, not negative: the pairs of associative Markov networks.
    initial : array-like of int, shape (n,), optional
        Labels to start from; by default the cheapest of each node.
    max_cycles : int, default 100
        How often each label may have its turn; three to five times are usual until nothing changes.

    Returns
    -------
    labels : ndarray of int32, shape (n,)
        The labelling.
    energy : float
        Its energy.

    Raises
    ------
    DataError
        If a shape does not fit, a number is not finite, an edge is a loop or names a node that does not exist,
        `initial` names a label that does not exist, or a weight or agreement is negative.
    ParameterError
        If `label_costs` is not a metric or `max_cycles` is below 1.

    Examples
    --------
    >>> labels, energy = minimize([[0, 3], [1, 0], [0, 3]], [[0, 1], [1, 2]], [1.0, 1.0])
    >>> labels.tolist(), energy
    ([0, 0, 0], 1.0)
    """
    problem = PairwiseEnergy.checked(unary, edges, weights, label_costs, agreement)
    graph = CutGraph(problem.edges, len(problem.unary))
    gain, slack = np.empty(len(problem.unary)), np.empty(len(problem.edges))

    def move(labels: NDArray[np.int32], alpha: int) -> NDArray[np.bool_]:
        problem.write_move(labels, alpha, gain, slack)
        return graph.minimize(gain, slack, labels == alpha)

    return expand_in_turn(
        initial_labels(problem.unary, initial),
        n_labels=problem.unary.shape[1],
        max_cycles=max_cycles,
        energy=problem.of,
        move=move,
    )
