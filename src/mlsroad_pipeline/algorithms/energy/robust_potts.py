"""Robust P^n Potts cliques in alpha-expansion (Kohli, Ladicky and Torr 2009, equation 9 and section 4).

The cost of a clique is the minimum over labels k of its uniform cost of k, increased linearly with the weight of the
deviating members, and truncated at a maximum:

    psi(y) = min(maximum, min_k [uniform_k + deviating_k(y) * (maximum - uniform_k) / truncation])

where deviating_k is the weight of the members without label k. In an expansion of alpha only two labels can lower the
cost of a clique: alpha, and the one label of sufficiently many members. Each adds one binary variable, which selects
between the cost of that label and the maximum.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.energy.alpha_expansion import PairwiseEnergy, expand_in_turn, initial_labels
from mlsroad_pipeline.algorithms.energy.binary_cut import CutGraph


@dataclass(frozen=True, eq=False)
class Cliques:
    """Groups of nodes with a cost for deviating labels."""

    indptr: NDArray[np.int64]  # Start of each clique in `members`
    members: NDArray[np.int32]  # Node indices, clique by clique. A node may belong to several cliques.
    # Cost of a clique if all members have label k, at most `maximum`; negative for a reward
    uniform: NDArray[np.float64]
    maximum: NDArray[np.float64]  # Maximum cost of a clique
    # Weight of deviating members at which the maximum is reached, above 0 and at most half the weight of the clique.
    # Small values approach the strict P^n Potts model, large values tolerate many deviating members.
    truncation: NDArray[np.float64]
    weights: NDArray[np.float64] | None = None  # Weight of each member, at least 0; 1 by default

    def __post_init__(self) -> None:
        if self.weights is None:
            object.__setattr__(self, "weights", np.ones(np.shape(self.members)))
        for name, dtype in (("indptr", np.int64), ("members", np.int32)):
            values = np.asarray(getattr(self, name))
            if values.ndim != 1 or (len(values) and not np.issubdtype(values.dtype, np.integer)):
                raise DataError(f"{name} of cliques must be integers in one dimension, got {values.dtype}")
            object.__setattr__(self, name, np.ascontiguousarray(values, dtype=dtype))
        for name in ("uniform", "maximum", "truncation", "weights"):
            numbers = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if not np.isfinite(numbers).all():
                raise DataError(f"{name} of cliques must be finite")
            object.__setattr__(self, name, numbers)
        self._check()

    def _check(self) -> None:
        n, starts = len(self), self.indptr
        if len(starts) == 0 or starts[0] != 0 or starts[-1] != len(self.members) or (np.diff(starts) < 0).any():
            raise DataError(f"indptr of cliques must rise from 0 to {len(self.members)}")
        shapes = (self.uniform.ndim, len(self.uniform), self.maximum.shape, self.truncation.shape)
        if shapes != (2, n, (n,), (n,)) or self.member_weights.shape != self.members.shape:
            raise DataError(f"uniform, maximum and truncation of {n} cliques have inconsistent shapes: {shapes}")
        if (self.member_weights < 0).any():
            raise DataError(f"weights of cliques must not be negative, got {self.member_weights.min()}")
        above = np.flatnonzero((self.uniform > self.maximum[:, None]).any(axis=1))
        if len(above):
            raise DataError(f"clique {above[0]} has a uniform cost above its maximum of {self.maximum[above[0]]}")
        cumulated = np.concatenate([[0.0], np.cumsum(self.member_weights)])
        total = cumulated[starts[1:]] - cumulated[starts[:-1]]
        wrong = np.flatnonzero((self.truncation <= 0) | (2 * self.truncation > total * (1 + 1e-9)))
        if len(wrong):
            first = wrong[0]
            raise DataError(
                f"truncation of clique {first} must be above 0 and at most half of its weight of {total[first]}, "
                f"got {self.truncation[first]}: otherwise two labels could suit it at once"
            )

    def __len__(self) -> int:
        """Return the number of cliques."""
        return max(len(self.indptr) - 1, 0)

    @property
    def member_weights(self) -> NDArray[np.float64]:
        """Weight of each member."""
        return np.asarray(self.weights, dtype=np.float64)


@njit(cache=True, nogil=True)
def _deviating(
    c: int, labels: NDArray[np.int32], indptr: NDArray[np.int64], members: NDArray[np.int32], weights: NDArray
) -> NDArray[np.float64]:
    """Return, for each label k, the weight of the members of a clique without label k."""
    share = np.zeros(labels.max() + 1)
    for s in range(indptr[c], indptr[c + 1]):
        share[labels[members[s]]] += weights[s]
    return share.sum() - share


@njit(cache=True, nogil=True)
def _clique_energy(
    labels: NDArray[np.int32],
    indptr: NDArray[np.int64],
    members: NDArray[np.int32],
    weights: NDArray[np.float64],
    uniform: NDArray[np.float64],
    maximum: NDArray[np.float64],
    truncation: NDArray[np.float64],
) -> float:
    total = 0.0
    for c in range(len(maximum)):
        deviating = _deviating(c, labels, indptr, members, weights)
        cost = maximum[c]
        for k in range(len(deviating)):  # a label without members costs at least the maximum
            cost = min(cost, uniform[c, k] + deviating[k] * (maximum[c] - uniform[c, k]) / truncation[c])
        total += cost
    return total


@njit(cache=True, nogil=True)
def _clique_terms(
    labels: NDArray[np.int32],
    alpha: int,
    indptr: NDArray[np.int64],
    members: NDArray[np.int32],
    weights: NDArray[np.float64],
    uniform: NDArray[np.float64],
    maximum: NDArray[np.float64],
    truncation: NDArray[np.float64],
    gain: NDArray[np.float64],
    slack: NDArray[np.float64],
) -> None:
    """Add the cliques to the binary energy of a move.

    `gain` ends with two variables per clique: "cost of alpha" and "maximum instead of the cost of the present label".
    `slack` ends with two edges per member, to these variables.
    """
    n_nodes, n_edges = len(labels), len(slack) - 2 * len(members)
    for c in range(len(maximum)):
        takes, leaves = n_nodes + 2 * c, n_nodes + 2 * c + 1
        deviating = _deviating(c, labels, indptr, members, weights)
        present = -1
        for k in range(len(deviating)):
            if k != alpha and deviating[k] < truncation[c]:  # true for at most one label
                present = k
        rate = (maximum[c] - uniform[c, alpha]) / truncation[c]
        gain[takes] = uniform[c, alpha] - maximum[c]
        gain[leaves] = 0.0
        present_rate = 0.0
        if present >= 0:
            present_rate = (maximum[c] - uniform[c, present]) / truncation[c]
            gain[leaves] = maximum[c] - uniform[c, present] - present_rate * deviating[present]
        for s in range(indptr[c], indptr[c + 1]):
            i, e = members[s], n_edges + 2 * s
            slack[e], slack[e + 1] = 0.0, 0.0
            if labels[i] != alpha:  # cost if the clique selects alpha and the member keeps its label
                half = 0.5 * rate * weights[s]
                slack[e] = half
                gain[takes] += half
                gain[i] -= half
            if labels[i] == present:  # cost if the clique keeps its label and the member takes alpha
                half = 0.5 * present_rate * weights[s]
                slack[e + 1] = half
                gain[leaves] -= half
                gain[i] += half


def _with_cliques(edges: NDArray[np.int32], cliques: Cliques, n_nodes: int) -> CutGraph:
    owner = np.repeat(np.arange(len(cliques), dtype=np.int32), np.diff(cliques.indptr))
    further = np.empty((2 * len(owner), 2), dtype=np.int32)
    further[:, 0] = np.repeat(cliques.members, 2)
    further[0::2, 1] = n_nodes + 2 * owner
    further[1::2, 1] = n_nodes + 2 * owner + 1
    return CutGraph(np.concatenate([edges, further]), n_nodes + 2 * len(cliques))


def minimize(
    unary: ArrayLike,
    edges: ArrayLike,
    weights: ArrayLike,
    cliques: Cliques,
    *,
    agreement: ArrayLike | None = None,
    initial: ArrayLike | None = None,
    max_cycles: int = 100,
) -> tuple[NDArray[np.int32], float]:
    """Minimise an energy of unary, pairwise and robust P^n Potts terms by alpha-expansion.

    Every expansion is optimal among all 2**n. No expansion lowers the energy of the result.
    """
    pairs = PairwiseEnergy.checked(unary, edges, weights, agreement)
    n_nodes, n_labels = pairs.unary.shape
    if len(cliques) and cliques.uniform.shape[1] != n_labels:
        raise DataError(f"cliques have {cliques.uniform.shape[1]} labels, unary has {n_labels}")
    if len(cliques.members) and not 0 <= cliques.members.min() <= cliques.members.max() < n_nodes:
        raise DataError(
            f"cliques name nodes {cliques.members.min()} to {cliques.members.max()}, but there are {n_nodes}"
        )
    members = (cliques.indptr, cliques.members, cliques.member_weights)
    groups = (*members, cliques.uniform, cliques.maximum, cliques.truncation)
    graph = _with_cliques(pairs.edges, cliques, n_nodes)
    gain, slack = np.empty(graph.n_nodes), np.empty(len(graph.edges))
    fixed = np.zeros(graph.n_nodes, dtype=np.bool_)

    def energy(labels: NDArray[np.int32]) -> float:
        return pairs.of(labels) + (float(_clique_energy(labels, *groups)) if len(cliques) else 0.0)

    def move(labels: NDArray[np.int32], alpha: int) -> NDArray[np.bool_]:
        pairs.write_move(labels, alpha, gain[:n_nodes], slack[: len(pairs.edges)])
        if len(cliques):
            _clique_terms(labels, alpha, *groups, gain, slack)
        fixed[:n_nodes] = labels == alpha
        return graph.minimize(gain, slack, fixed)[:n_nodes]

    labels = initial_labels(pairs.unary, initial)
    return expand_in_turn(labels, n_labels=n_labels, max_cycles=max_cycles, energy=energy, move=move)
