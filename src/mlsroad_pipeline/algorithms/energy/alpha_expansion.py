"""Alpha-expansion by graph cuts on general graphs (Boykov, Veksler and Zabih 2001, section 5).

The energy of a labelling y is

    E(y) = sum_i unary[i, y_i] + sum_e weights[e] * [y_i != y_j] - sum_e agreement[e, k] * [y_i = y_j = k]

with the ends i and j of edge e. In an expansion of label alpha every node keeps its label or takes alpha; a minimum cut
gives the best of these 2**n labellings. The labels are expanded cyclically until no expansion lowers the energy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.algorithms.energy.binary_cut import CutGraph, near_numbers
from mlsroad_pipeline.algorithms.geometry.graphs import check_edges


@njit(cache=True, nogil=True)
def _pair(
    e: int,
    a: int,
    b: int,
    weights: NDArray[np.float64],
    agreement: NDArray[np.float64],
) -> float:
    if a != b:
        return weights[e]
    return -agreement[e, a] if len(agreement) else 0.0


@njit(cache=True, nogil=True)
def _energy(
    labels: NDArray[np.int32],
    unary: NDArray[np.float64],
    edges: NDArray[np.int32],
    weights: NDArray[np.float64],
    agreement: NDArray[np.float64],
) -> float:
    total = 0.0
    for i in range(len(labels)):
        total += unary[i, labels[i]]
    for e in range(len(edges)):
        total += _pair(e, labels[edges[e, 0]], labels[edges[e, 1]], weights, agreement)
    return total


@njit(cache=True, nogil=True)
def _move_terms(
    labels: NDArray[np.int32],
    alpha: int,
    unary: NDArray[np.float64],
    edges: NDArray[np.int32],
    weights: NDArray[np.float64],
    agreement: NDArray[np.float64],
    gain: NDArray[np.float64],
    slack: NDArray[np.float64],
) -> None:
    """Write the terms of an expansion of alpha: gain_i for taking alpha, slack_e for ends that differ in the move."""
    for i in range(len(labels)):
        gain[i] = unary[i, alpha] - unary[i, labels[i]]
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        a, b = labels[i], labels[j]
        slack[e] = 0.0
        if a == alpha and b == alpha:
            continue
        both = _pair(e, alpha, alpha, weights, agreement)
        if a == alpha:
            gain[j] += both - _pair(e, alpha, b, weights, agreement)
        elif b == alpha:
            gain[i] += both - _pair(e, a, alpha, weights, agreement)
        else:
            neither = _pair(e, a, b, weights, agreement)
            first = _pair(e, alpha, b, weights, agreement)
            second = _pair(e, a, alpha, weights, agreement)
            # neither + c_i x_i + c_j x_j + s |x_i - x_j| takes these four values if s is at least 0.
            slack[e] = max(0.5 * (first + second - neither - both), 0.0)
            gain[i] += 0.5 * (first - second + both - neither)
            gain[j] += 0.5 * (second - first + both - neither)


def _finite(values: ArrayLike, shape: tuple[int, ...], name: str) -> NDArray[np.float64]:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != shape:
        raise DataError(f"{name} must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        first = np.argwhere(~np.isfinite(array))[0].tolist()
        raise DataError(f"{name} must be finite, got {array[tuple(first)]} at {first}")
    return array


@dataclass(frozen=True)
class PairwiseEnergy:
    """Validated energy of unary and pairwise terms."""

    unary: NDArray[np.float64]  # Cost of label k at node i
    edges: NDArray[np.int32]  # Ends of the edges
    weights: NDArray[np.float64]  # Cost of different labels at the ends of an edge
    agreement: NDArray[np.float64]  # Reward of an edge if both ends have label k

    @classmethod
    def checked(
        cls,
        unary: ArrayLike,
        edges: ArrayLike,
        weights: ArrayLike,
        agreement: ArrayLike | None = None,
    ) -> PairwiseEnergy:
        """Validate the arguments of `minimize` and return the energy."""
        array = np.asarray(unary)
        if array.ndim != 2 or array.shape[1] == 0:
            raise DataError(f"unary must have shape (n, l) with at least one label, got {array.shape}")
        n_nodes, n_labels = array.shape
        pairs = check_edges(edges, n_nodes)
        loops = np.flatnonzero(pairs[:, 0] == pairs[:, 1])
        if len(loops):
            raise DataError(f"edge {loops[0]} joins node {pairs[loops[0], 0]} to itself")
        factors = _finite(
            np.broadcast_to(weights, (len(pairs),)) if np.ndim(weights) == 0 else weights, (len(pairs),), "weights"
        )
        rewards = np.zeros((0, n_labels))
        if agreement is not None:
            rewards = _finite(agreement, (len(pairs), n_labels), "agreement")
        for values, name in ((factors, "weights"), (rewards, "agreement")):
            if (values < 0).any():
                raise DataError(f"{name} must not be negative, got {values.min()}: the moves would not be submodular")
        return cls(_finite(array, array.shape, "unary"), pairs.astype(np.int32), factors, rewards)

    def renumbered(self, number: NDArray[np.int32], order: NDArray[np.integer]) -> PairwiseEnergy:
        """Return the same energy with other numbers of the nodes."""
        ends = np.sort(number[self.edges], axis=1)
        by_node = np.argsort(ends[:, 0].astype(np.int64) * len(order) + ends[:, 1], kind="stable")
        agreement = self.agreement[by_node] if len(self.agreement) else self.agreement
        edges, unary = np.ascontiguousarray(ends[by_node]), np.ascontiguousarray(self.unary[order])
        return replace(self, unary=unary, edges=edges, weights=self.weights[by_node], agreement=agreement)

    def of(self, labels: NDArray[np.int32]) -> float:
        """Return the energy of a labelling."""
        return float(_energy(labels, self.unary, self.edges, self.weights, self.agreement))

    def write_move(
        self, labels: NDArray[np.int32], alpha: int, gain: NDArray[np.float64], slack: NDArray[np.float64]
    ) -> None:
        """Write the binary energy of an expansion."""
        _move_terms(labels, alpha, self.unary, self.edges, self.weights, self.agreement, gain, slack)


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
