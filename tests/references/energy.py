"""Slow, obvious energies of labellings and their minima by enumeration."""

from itertools import product

import numpy as np


def energy_of(labels, unary, edges, weights, agreement=None, cliques=()):
    """Sum the terms one by one; cliques are tuples of (members, member weights, truncation, label costs, maximum)."""
    n_labels = np.shape(unary)[1]
    total = sum(unary[i][label] for i, label in enumerate(labels))
    for e, (i, j) in enumerate(edges):
        total += weights[e] * (labels[i] != labels[j])
        if agreement is not None and labels[i] == labels[j]:
            total -= agreement[e][labels[i]]
    for members, shares, truncation, uniform, ceiling in cliques:
        values = [ceiling]
        for label in range(n_labels):
            deviating = sum(share for i, share in zip(members, shares, strict=True) if labels[i] != label)
            values.append(uniform[label] + deviating * (ceiling - uniform[label]) / truncation)
        total += min(values)
    return float(total)


def global_minimum(unary, *terms, **more):
    """Try all labellings."""
    n, n_labels = np.shape(unary)
    return min(energy_of(labels, unary, *terms, **more) for labels in product(range(n_labels), repeat=n))


def best_expansion(labels, alpha, unary, *terms, **more):
    """Try all labellings in which every node keeps its label or takes alpha; return the lowest energy."""
    choices = [{int(label), alpha} for label in labels]
    return min(energy_of(moved, unary, *terms, **more) for moved in product(*choices))


def iterated_conditional_modes(unary, edges, weights, labels):
    """Give each node its best label with the others held, until nothing changes (Potts model)."""
    labels, n_labels = labels.copy(), unary.shape[1]
    neighbours = [[] for _ in range(len(unary))]
    for (i, j), weight in zip(edges, weights, strict=True):
        neighbours[i].append((j, weight))
        neighbours[j].append((i, weight))
    changed = True
    while changed:
        changed = False
        for i, around in enumerate(neighbours):
            cost = unary[i].copy()
            for j, weight in around:
                cost += weight * (np.arange(n_labels) != labels[j])
            best = int(cost.argmin())
            if cost[best] < cost[labels[i]] - 1e-12:
                labels[i], changed = best, True
    return labels
