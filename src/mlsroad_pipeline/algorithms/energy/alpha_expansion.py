"""Alpha-expansion by graph cuts on general graphs (Boykov, Veksler and Zabih 2001, section 5).

The energy of a labelling y is

    E(y) = sum_i unary[i, y_i] + sum_e weights[e] * label_costs[y_i, y_j] - sum_e agreement[e, k] * [y_i = y_j = k]

with the ends i and j of edge e. An expansion of label alpha lets every node keep its label or take alpha; the best of
all these 2**n labellings is found at once, as a minimum cut. Labels take turns until none of them lowers the energy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.energy.binary_cut import CutGraph
from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.graphs import check_edges

_LEAST_GAIN = 1e-10
"""Share of the energy's size by which a move must lower it: below it lies the rounding of the sums."""


@njit(cache=True)
def _pair(
    e: int,
    a: int,
    b: int,
    weights: NDArray[np.float64],
    label_costs: NDArray[np.float64],
    agreement: NDArray[np.float64],
) -> float:
    cost = weights[e] * label_costs[a, b]
    return cost - agreement[e, a] if a == b and len(agreement) else cost


@njit(cache=True)
def _energy(
    labels: NDArray[np.int32],
    unary: NDArray[np.float64],
    edges: NDArray[np.int32],
    weights: NDArray[np.float64],
    label_costs: NDArray[np.float64],
    agreement: NDArray[np.float64],
) -> float:
    total = 0.0
    for i in range(len(labels)):
        total += unary[i, labels[i]]
    for e in range(len(edges)):
        total += _pair(e, labels[edges[e, 0]], labels[edges[e, 1]], weights, label_costs, agreement)
    return total


@njit(cache=True)
def _move_terms(
    labels: NDArray[np.int32],
    alpha: int,
    unary: NDArray[np.float64],
    edges: NDArray[np.int32],
    weights: NDArray[np.float64],
    label_costs: NDArray[np.float64],
    agreement: NDArray[np.float64],
    gain: NDArray[np.float64],
    slack: NDArray[np.float64],
) -> None:
    """Write what an expansion of alpha costs: gain_i for taking alpha, slack_e for ends that decide differently."""
    for i in range(len(labels)):
        gain[i] = unary[i, alpha] - unary[i, labels[i]]
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        a, b = labels[i], labels[j]
        slack[e] = 0.0
        if a == alpha and b == alpha:
            continue
        both = _pair(e, alpha, alpha, weights, label_costs, agreement)
        if a == alpha:
            gain[j] += both - _pair(e, alpha, b, weights, label_costs, agreement)
        elif b == alpha:
            gain[i] += both - _pair(e, a, alpha, weights, label_costs, agreement)
        else:
            neither = _pair(e, a, b, weights, label_costs, agreement)
            first = _pair(e, alpha, b, weights, label_costs, agreement)
            second = _pair(e, a, alpha, weights, label_costs, agreement)
            # neither + c_i x_i + c_j x_j + s |x_i - x_j| takes these four values where s is not negative.
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


def _check_label_costs(label_costs: ArrayLike | None, n_labels: int) -> NDArray[np.float64]:
    if label_costs is None:
        return 1.0 - np.eye(n_labels)
    costs = _finite(label_costs, (n_labels, n_labels), "label_costs")
    if (costs != costs.T).any() or (np.diagonal(costs) != 0).any() or (costs < 0).any():
        raise ParameterError("label_costs must be symmetric, not negative, and 0 on the diagonal")
    for a, b in product(range(n_labels), repeat=2):
        detour = costs[a] + costs[:, b]
        if costs[a, b] > detour.min() * (1 + 1e-12):
            via = int(detour.argmin())
            raise ParameterError(
                f"label_costs must be a metric: {costs[a, b]} from label {a} to {b} exceeds {detour[via]} by way of "
                f"{via}, so an expansion of {via} would not be submodular"
            )
    return costs


@dataclass(frozen=True)
class PairwiseEnergy:
    """The energy of unary terms and pairs, checked.

    Attributes
    ----------
    unary : ndarray of float64, shape (n, l)
        What node i pays for label k.
    edges : ndarray of int32, shape (e, 2)
        Ends of the edges.
    weights : ndarray of float64, shape (e,)
        Factors of the label costs.
    label_costs : ndarray of float64, shape (l, l)
        What two labels cost at the ends of an edge of weight 1.
    agreement : ndarray of float64, shape (e, l) or (0, l)
        What an edge gains where both of its ends have label k.
    """

    unary: NDArray[np.float64]
    edges: NDArray[np.int32]
    weights: NDArray[np.float64]
    label_costs: NDArray[np.float64]
    agreement: NDArray[np.float64]

    @classmethod
    def checked(
        cls,
        unary: ArrayLike,
        edges: ArrayLike,
        weights: ArrayLike,
        label_costs: ArrayLike | None = None,
        agreement: ArrayLike | None = None,
    ) -> PairwiseEnergy:
        """Build an energy from what a caller gives; see `minimize` for the arguments and errors.

        Parameters
        ----------
        unary, edges, weights, label_costs, agreement : array-like
            As in `minimize`.

        Returns
        -------
        PairwiseEnergy
            The energy, all arrays contiguous.

        Raises
        ------
        DataError
            As `minimize` does.
        ParameterError
            As `minimize` does.
        """
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
        costs = _check_label_costs(label_costs, n_labels)
        return cls(_finite(array, array.shape, "unary"), pairs.astype(np.int32), factors, costs, rewards)

    def of(self, labels: NDArray[np.int32]) -> float:
        """Return the energy of a labelling.

        Parameters
        ----------
        labels : ndarray of int32, shape (n,)
            A label per node.

        Returns
        -------
        float
            The energy.
        """
        return float(_energy(labels, self.unary, self.edges, self.weights, self.label_costs, self.agreement))

    def write_move(
        self, labels: NDArray[np.int32], alpha: int, gain: NDArray[np.float64], slack: NDArray[np.float64]
    ) -> None:
        """Write the binary energy of an expansion.

        Parameters
        ----------
        labels : ndarray of int32, shape (n,)
            The present labelling.
        alpha : int
            The label that may be taken.
        gain : ndarray of float64, shape (n,)
            Receives the cost of taking alpha.
        slack : ndarray of float64, shape (e,)
            Receives the cost of ends that decide differently.
        """
        _move_terms(labels, alpha, self.unary, self.edges, self.weights, self.label_costs, self.agreement, gain, slack)


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
    if max_cycles < 1:
        raise ParameterError(f"max_cycles must be at least 1, got {max_cycles!r}")
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
