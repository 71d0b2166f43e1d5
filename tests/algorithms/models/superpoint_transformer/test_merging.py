"""Merging of regions: planted groups, and an energy that no merging of two groups lowers."""

from itertools import combinations

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.models.superpoint_transformer.levels import merge_regions


def grid_edges(n):
    cells = np.arange(n * n).reshape(n, n)
    return np.concatenate(
        [np.stack([a.ravel(), b.ravel()], axis=1) for a, b in ((cells[:-1], cells[1:]), (cells[:, :-1], cells[:, 1:]))]
    )


def energy(values, weights, edges, group, regularisation):
    cost = regularisation * (group[edges[:, 0]] != group[edges[:, 1]]).sum()
    for label in np.unique(group):
        rows = group == label
        mean = np.average(values[rows], axis=0, weights=weights[rows])
        cost += (weights[rows] * ((values[rows] - mean) ** 2).sum(axis=1)).sum()
    return cost


def test_planted_halves_are_found():
    values = np.repeat([[0.0], [1.0]], 32, axis=0) + np.random.default_rng(0).normal(0, 0.05, (64, 1))
    group = merge_regions(values, np.ones(64), grid_edges(8), regularisation=0.1)
    assert group.tolist() == np.repeat([0, 1], 32).tolist()


def test_regions_without_common_edge_stay_apart_and_equal_regions_join():
    edges = np.array([[0, 1], [2, 3]])
    assert merge_regions(np.zeros((4, 2)), np.ones(4), edges, regularisation=0.1).tolist() == [0, 0, 1, 1]
    assert merge_regions(np.zeros((4, 2)), np.ones(4), edges, regularisation=0.0).tolist() == [0, 1, 2, 3]
    assert merge_regions(np.zeros((3, 1)), np.ones(3), np.empty((0, 2), int), regularisation=1.0).tolist() == [0, 1, 2]


@pytest.mark.parametrize("seed", range(3))
def test_no_merging_of_two_groups_lowers_the_energy(seed):
    rng = np.random.default_rng(seed)
    values, weights, edges = rng.random((36, 2)), rng.uniform(0.5, 3, 36), grid_edges(6)
    group = merge_regions(values, weights, edges, regularisation=0.2)
    found = energy(values, weights, edges, group, 0.2)
    assert 1 < group.max() + 1 < 36
    assert found < energy(values, weights, edges, np.arange(36), 0.2)
    for a, b in combinations(range(group.max() + 1), 2):
        touching = ((group[edges] == a).any(axis=1) & (group[edges] == b).any(axis=1)).any()
        if touching:
            assert energy(values, weights, edges, np.where(group == b, a, group), 0.2) >= found - 1e-9
