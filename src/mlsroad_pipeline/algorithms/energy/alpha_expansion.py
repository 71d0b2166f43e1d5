"""Alpha-expansion by graph cuts on general graphs (Boykov, Veksler and Zabih 2001, section 5).

The energy of a labelling y is

    E(y) = sum_i unary[i, y_i] + sum_e weights[e] * [y_i != y_j] - sum_e agreement[e, k] * [y_i = y_j = k]

with the ends i and j of edge e. In an expansion of label alpha every node keeps its label or takes alpha; a minimum cut
gives the best of these 2**n labellings. The labels are expanded cyclically until no expansion lowers the energy.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.algorithms.energy.binary_cut import CutGraph, near_numbers
from mlsroad_pipeline.algorithms.energy.pairwise_energy import PairwiseEnergy

_LEAST_GAIN = 1e-10
"""Minimum relative decrease of the energy by a move; smaller changes are rounding."""


def initial_labels(unary: NDArray[np.float64], initial: ArrayLike | None) -> NDArray[np.int32]:
    """Return the initial labels, checked and copied, or else the label of lowest unary cost of each node."""
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
    """Expand the labels cyclically until no expansion lowers the energy; return the labelling and its energy.

    `move` returns the nodes that take alpha in the best expansion of a labelling.
    """
    check_at_least(max_cycles, 1, "max_cycles")
    lowest = energy(labels)
    idle = 0  # labels since the last decrease; that label itself needs no new trial
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
    agreement: ArrayLike | None = None,
    initial: ArrayLike | None = None,
    max_cycles: int = 100,
) -> tuple[NDArray[np.int32], float]:
    """Minimise an energy of unary and pairwise terms by alpha-expansion.

    No expansion lowers the energy of the result. With two labels the result is the global minimum. With more labels and
    without negative terms, its energy is at most twice the minimum (Boykov et al. 2001, Theorem 6.1). The result is
    deterministic.

    Parameters
    ----------
    unary : array-like of shape (n, l)
        Cost of label k at node i; any finite numbers.
    edges : array-like of int, shape (e, 2)
        Pairs of different nodes, each undirected edge once. The weights of repeated edges add up.
    weights : array-like of shape (e,) or a number
        Cost of different labels at the ends of each edge (Potts), at least 0. Larger weights give smoother labellings.
    agreement : array-like of shape (e, l), optional
        Reward of an edge if both ends have label k, at least 0, as in associative Markov networks.
    initial : array-like of int, shape (n,), optional
        Initial labels; by default the label of lowest unary cost of each node.
    max_cycles : int, default 100
        Maximum number of cycles over all labels; convergence usually takes three to five.

    Returns
    -------
    labels : ndarray of int32, shape (n,)
        The labelling.
    energy : float
        Its energy.

    Raises
    ------
    DataError
        If a shape does not match, a number is not finite, an edge is a loop or has an invalid node, `initial` has an
        invalid label, or a weight or agreement is negative.
    ParameterError
        If `max_cycles` is below 1.

    Examples
    --------
    >>> labels, energy = minimize([[0, 3], [1, 0], [0, 3]], [[0, 1], [1, 2]], [1.0, 1.0])
    >>> labels.tolist(), energy
    ([0, 0, 0], 1.0)
    """
    problem = PairwiseEnergy.checked(unary, edges, weights, agreement)
    first = initial_labels(problem.unary, initial)
    number = near_numbers(problem.edges, len(problem.unary))
    if number is not None:
        order = np.argsort(number)
        problem, first = problem.renumbered(number, order), first[order]
    graph = CutGraph(problem.edges, len(problem.unary))
    gain, slack = np.empty(len(problem.unary)), np.empty(len(problem.edges))

    def move(labels: NDArray[np.int32], alpha: int) -> NDArray[np.bool_]:
        problem.write_move(labels, alpha, gain, slack)
        return graph.minimize(gain, slack, labels == alpha)

    labels, lowest = expand_in_turn(
        first,
        n_labels=problem.unary.shape[1],
        max_cycles=max_cycles,
        energy=problem.of,
        move=move,
    )
    return labels if number is None else labels[number], lowest
