"""Energy of unary and pairwise terms, and of its expansion moves (Boykov, Veksler and Zabih 2001).

The formula of the energy is in `alpha_expansion`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
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
