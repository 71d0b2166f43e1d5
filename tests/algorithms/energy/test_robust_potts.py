"""Robust P^n Potts cliques against enumeration."""

from itertools import combinations

import numpy as np
import pytest
from references.energy import best_expansion, energy_of, global_minimum

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.energy import alpha_expansion
from mlsroad_pipeline.algorithms.energy.robust_potts import Cliques, minimize


def random_cliques(rng, n_nodes, n_labels, n_cliques, *, weighted):
    """Return the cliques in both forms: ours, and the reference's tuples."""
    rows = []
    for _ in range(n_cliques):
        members = rng.permutation(n_nodes)[: rng.integers(2, n_nodes + 1)]
        shares = rng.uniform(0.2, 2.0, len(members)) if weighted else np.ones(len(members))
        truncation = shares.sum() * rng.uniform(0.05, 0.5)
        maximum = rng.uniform(0, 6)
        rows.append((members, shares, truncation, maximum - rng.gamma(2.0, 1.5, n_labels), maximum))
    indptr = np.cumsum([0, *(len(row[0]) for row in rows)])
    members, shares = (np.concatenate([row[k] for row in rows]) for k in (0, 1))
    uniform, maximum, truncation = (np.array([row[k] for row in rows]) for k in (3, 4, 2))
    return Cliques(indptr, members, uniform, maximum, truncation, shares if weighted else None), rows


def random_problem(rng, n_nodes, n_labels):
    pairs = np.array(list(combinations(range(n_nodes), 2)))
    edges = pairs[rng.random(len(pairs)) < 0.3]
    return rng.normal(0, 2, (n_nodes, n_labels)), edges, rng.gamma(1.0, 0.5, len(edges))


@pytest.mark.parametrize("weighted", [False, True])
def test_two_labels_reach_the_best_of_all_expansions(rng, weighted):
    """With cliques of two labels one expansion of either label is exact over all labellings that keep the rest."""
    for trial in range(40):
        n_nodes = 3 + trial % 6
        unary, edges, weights = random_problem(rng, n_nodes, 2)
        cliques, rows = random_cliques(rng, n_nodes, 2, 1 + trial % 3, weighted=weighted)
        labels, energy = minimize(unary, edges, weights, cliques, initial=np.zeros(n_nodes, int))
        assert energy == pytest.approx(energy_of(labels, unary, edges, weights, cliques=rows), abs=1e-9)
        assert energy == pytest.approx(global_minimum(unary, edges, weights, cliques=rows), abs=1e-9)


@pytest.mark.parametrize("weighted", [False, True])
def test_no_expansion_by_enumeration_beats_three_labels(rng, weighted):
    for trial in range(30):
        n_nodes = 3 + trial % 6
        unary, edges, weights = random_problem(rng, n_nodes, 3)
        more = {"agreement": rng.gamma(1.0, 0.5, (len(edges), 3))}
        cliques, rows = random_cliques(rng, n_nodes, 3, 1 + trial % 4, weighted=weighted)
        initial = rng.integers(0, 3, n_nodes)
        labels, energy = minimize(unary, edges, weights, cliques, initial=initial, **more)
        assert energy == pytest.approx(energy_of(labels, unary, edges, weights, cliques=rows, **more), abs=1e-9)
        for alpha in range(3):
            lowest = best_expansion(labels, alpha, unary, edges, weights, cliques=rows, **more)
            assert energy <= lowest + 1e-9


def test_without_cliques_it_is_alpha_expansion(rng):
    problem = random_problem(rng, 60, 4)
    none = Cliques([0], [], np.zeros((0, 4)), [], [])
    labels, energy = minimize(*problem, none)
    expected, same = alpha_expansion.minimize(*problem)
    assert np.array_equal(labels, expected) and energy == same


def test_a_clique_of_two_is_an_edge(rng):
    """With a truncation of half of its weight, a pair pays 0 where it agrees and its maximum where not: Potts."""
    unary, edges, weights = random_problem(rng, 40, 3)
    pairs = Cliques(
        2 * np.arange(len(edges) + 1), edges.ravel(), np.zeros((len(edges), 3)), weights, np.ones(len(edges))
    )
    labels, energy = minimize(unary, [], [], pairs)
    expected, same = alpha_expansion.minimize(unary, edges, weights)
    assert energy == pytest.approx(same) and np.array_equal(labels, expected)


def test_truncation_decides_how_many_may_deviate():
    unary = np.zeros((10, 2))
    unary[:7, 1], unary[7:, 0] = 1.0, 1.0  # seven lean to label 0, three to label 1

    def labels(truncation, maximum):
        clique = Cliques([0, 10], np.arange(10), np.zeros((1, 2)), [maximum], [truncation])
        return minimize(unary, [], [], clique)[0].tolist()

    assert labels(5.0, 4.0) == [0] * 7 + [1] * 3  # three deviating members cost 3 * 4 / 5 < 3
    assert labels(3.5, 4.0) == [0] * 10  # 3 * 4 / 3.5 > 3
    assert labels(3.5, 2.9) == [0] * 7 + [1] * 3  # the maximum is less than what the three would pay


@pytest.mark.parametrize(
    "change, message",
    [
        ({"indptr": [0, 2]}, "indptr of cliques must rise from 0 to 3"),
        ({"members": [0.0, 1.0, 2.0]}, "members of cliques must be integers"),
        ({"uniform": [[0.0, 3.0]]}, "clique 0 has a uniform cost above its maximum of 2.0"),
        ({"maximum": [np.nan]}, "maximum of cliques must be finite"),
        ({"maximum": [2.0, 2.0]}, "uniform, maximum and truncation of 1 cliques"),
        ({"truncation": [0.0]}, "truncation of clique 0 must be above 0"),
        ({"truncation": [1.6]}, "at most half of its weight of 3.0, got 1.6"),
        ({"weights": [1.0, 1.0, -1.0]}, "weights of cliques must not be negative"),
    ],
)
def test_bad_cliques_are_named(change, message):
    given = {"indptr": [0, 3], "members": [0, 1, 2], "uniform": [[0.0, 1.0]], "maximum": [2.0], "truncation": [1.0]}
    with pytest.raises(DataError, match=message):
        Cliques(**{**given, **change})


def test_cliques_must_fit_the_nodes_and_labels():
    def clique(members, n_labels):
        return Cliques([0, 3], members, np.zeros((1, n_labels)), [1.0], [1.0])

    with pytest.raises(DataError, match="cliques name nodes 0 to 5, but there are 3"):
        minimize(np.zeros((3, 2)), [], [], clique([0, 1, 5], 2))
    with pytest.raises(DataError, match="cliques have 3 labels, unary has 2"):
        minimize(np.zeros((3, 2)), [], [], clique([0, 1, 2], 3))
