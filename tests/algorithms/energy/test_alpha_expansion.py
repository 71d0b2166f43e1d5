"""Alpha-expansion against enumeration, against simpler minimisers, and at its borders."""

from itertools import combinations, product

import numpy as np
import pytest
from references.energy import best_expansion, energy_of, global_minimum, iterated_conditional_modes
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.energy.alpha_expansion import minimize
from mlsroad_pipeline.algorithms.energy.binary_cut import CutGraph


def random_problem(rng, n_nodes, n_labels, *, whole_numbers=False):
    pairs = np.array(list(combinations(range(n_nodes), 2))).reshape(-1, 2)
    edges = pairs[rng.random(len(pairs)) < 0.5]
    unary, weights = rng.normal(0, 2, (n_nodes, n_labels)), rng.gamma(1.0, 1.0, len(edges))
    if whole_numbers:  # ties everywhere
        unary, weights = np.round(unary), np.round(weights)
    flipped = rng.random(len(edges)) < 0.5
    edges[flipped] = edges[flipped, ::-1]
    return unary, edges, weights


@pytest.mark.parametrize("whole_numbers", [False, True])
def test_two_labels_reach_the_global_minimum(rng, whole_numbers):
    for n_nodes in range(1, 9):
        for _ in range(12):
            problem = random_problem(rng, n_nodes, 2, whole_numbers=whole_numbers)
            labels, energy = minimize(*problem)
            assert energy == pytest.approx(global_minimum(*problem), abs=1e-9)
            assert energy == pytest.approx(energy_of(labels, *problem), abs=1e-9)


@pytest.mark.parametrize("whole_numbers", [False, True])
@pytest.mark.parametrize("kind", ["potts", "agreement"])
def test_no_expansion_by_enumeration_beats_three_labels(rng, kind, whole_numbers):
    """The minimum over all 2**n expansions is the energy itself, and the known bound to the global one holds."""
    optimal = 0
    for trial in range(40):
        unary, edges, weights = random_problem(rng, 1 + trial % 8, 3, whole_numbers=whole_numbers)
        unary -= unary.min()  # the bound is for energies without negative terms
        more = {"agreement": rng.gamma(1.0, 1.0, (len(edges), 3))} if kind == "agreement" else {}
        labels, energy = minimize(unary, edges, weights, **more)
        assert energy == pytest.approx(energy_of(labels, unary, edges, weights, **more), abs=1e-9)
        for alpha in range(3):
            assert energy <= best_expansion(labels, alpha, unary, edges, weights, **more) + 1e-9
        if trial % 8 > 5:
            continue  # enumerating 3**8 labellings is slow
        lowest = global_minimum(unary, edges, weights, **more)
        optimal += energy <= lowest + 1e-9
        if kind != "agreement":
            assert energy <= 2 * lowest + 1e-9
    assert optimal >= 24  # of 30


@pytest.mark.parametrize("kind", ["potts", "agreement"])
def test_one_expansion_is_optimal(rng, kind):
    """From any labelling, not only the one that minimisation ends in: one cycle of one label that costs least."""
    for trial in range(30):
        unary, edges, weights = random_problem(rng, 2 + trial % 7, 3)
        more = {"agreement": rng.gamma(1.0, 1.0, (len(edges), 3))} if kind == "agreement" else {}
        initial = rng.integers(1, 3, len(unary))
        expected = best_expansion(initial, 0, unary, edges, weights, **more)
        # Labels 1 and 2 have their turns after label 0 and can only go lower; max_cycles cannot stop in between.
        _, energy = minimize(unary, edges, weights, initial=initial, max_cycles=1, **more)
        assert energy <= expected + 1e-9


def test_cut_graph_is_exact_and_prefers_zero(rng):
    for n_nodes in range(1, 9):
        for _ in range(25):
            gain, edges, slack = random_problem(rng, n_nodes, 1, whole_numbers=True)
            gain = gain[:, 0]
            values = {
                x: float(gain @ x + sum(s * (x[i] != x[j]) for s, (i, j) in zip(slack, edges, strict=True)))
                for x in product((0, 1), repeat=n_nodes)
            }
            lowest = min(values.values())
            found = CutGraph(edges, n_nodes).minimize(gain.copy(), slack, np.zeros(n_nodes, bool))
            best = [x for x, value in values.items() if value == lowest]
            assert tuple(found.astype(int)) == min(best, key=sum)  # the minima form a lattice: the least is unique


def test_large_graphs_end_below_iterated_conditional_modes(rng):
    xyz = rng.uniform(0, 8, (4000, 3))
    edges = cKDTree(xyz).query_pairs(0.75, output_type="ndarray")
    truth = (xyz[:, 0] // 2).astype(int)
    unary = rng.normal(0, 1.5, (len(xyz), 4)) + 2.0 * (np.arange(4) != truth[:, None])
    weights = rng.uniform(0.2, 1.0, len(edges))
    labels, energy = minimize(unary, edges, weights)
    modes = iterated_conditional_modes(unary, edges, weights, unary.argmin(axis=1))
    assert energy < energy_of(modes, unary, edges, weights)
    assert (labels == truth).mean() > (unary.argmin(axis=1) == truth).mean() + 0.2
    # A far start ends nearby, and a warm one where it starts.
    _, other = minimize(unary, edges, weights, initial=np.full(len(xyz), 3))
    assert other == pytest.approx(energy, rel=1e-3)
    again, same = minimize(unary, edges, weights, initial=labels)
    assert same == energy and np.array_equal(again, labels)
    reverse, _ = minimize(unary, edges[::-1, ::-1].copy(), weights[::-1].copy())
    assert (reverse == labels).mean() > 0.999


def test_the_result_depends_on_the_arguments_alone(rng):
    unary, edges, weights = random_problem(rng, 60, 4)
    for array in (unary, edges, weights):
        array.flags.writeable = False
    labels, energy = minimize(unary, edges, weights)
    again, same = minimize(np.asfortranarray(unary), edges.astype(np.int32), weights.tolist())
    assert labels.dtype == np.int32 and labels.tobytes() == again.tobytes() and energy == same


def test_without_edges_the_cheapest_labels_are_taken(rng):
    unary = rng.normal(size=(50, 4))
    labels, energy = minimize(unary, np.zeros((0, 2), int), [])
    assert np.array_equal(labels, unary.argmin(axis=1)) and energy == pytest.approx(unary.min(axis=1).sum())
    labels, energy = minimize(np.zeros((0, 3)), [], [])
    assert labels.shape == (0,) and labels.dtype == np.int32 and energy == 0.0
    assert minimize([[5.0]], [], 1.0)[1] == 5.0


def test_parallel_edges_add_up():
    unary = [[0.0, 5.0], [1.5, 0.0]]
    assert minimize(unary, [[0, 1]], 1.0)[0].tolist() == [0, 1]
    assert minimize(unary, [[0, 1], [1, 0]], 1.0)[0].tolist() == [0, 0]


def test_heavy_edges_join_a_component(rng):
    unary, _, _ = random_problem(rng, 40, 3)
    chain = np.column_stack([np.arange(39), np.arange(1, 40)])
    keep = chain[:, 0] != 19  # two chains of 20
    labels, energy = minimize(unary, chain[keep], 1e6)
    parts = unary[:20].sum(axis=0), unary[20:].sum(axis=0)
    assert labels[:20].tolist() == [parts[0].argmin()] * 20 and labels[20:].tolist() == [parts[1].argmin()] * 20
    assert energy == pytest.approx(sum(part.min() for part in parts))


@pytest.mark.parametrize(
    "change, error, message",
    [
        ({"unary": np.zeros(3)}, DataError, r"unary must have shape \(n, l\).*\(3,\)"),
        ({"unary": np.zeros((3, 0))}, DataError, "at least one label"),
        ({"unary": [[0, 1], [0, np.nan], [0, 1]]}, DataError, r"unary must be finite, got nan at \[1, 1\]"),
        ({"unary": [[0, 1], [0, np.inf], [0, 1]]}, DataError, "unary must be finite, got inf"),
        ({"edges": [[0, 3]], "weights": [1.0]}, DataError, "node 3, but there are 3"),
        ({"edges": [[0, 1], [2, 2]]}, DataError, "edge 1 joins node 2 to itself"),
        ({"edges": [[0.0, 1.0], [1.0, 2.0]]}, DataError, "edges must be integers"),
        ({"weights": [1.0]}, DataError, r"weights must have shape \(2,\), got \(1,\)"),
        ({"weights": [1.0, -0.5]}, DataError, "weights must not be negative, got -0.5"),
        ({"agreement": [[0, 1], [0, -2]]}, DataError, "agreement must not be negative, got -2"),
        ({"initial": [0, 1, 2]}, DataError, "labels from 0 to 2, but there are 2"),
        ({"initial": [0.0, 1.0, 1.0]}, DataError, "initial must hold 3 integers"),
        ({"max_cycles": 0}, ParameterError, "max_cycles must be at least 1, got 0"),
    ],
)
def test_bad_input_is_named(change, error, message):
    given = {"unary": np.zeros((3, 2)), "edges": [[0, 1], [1, 2]], "weights": [1.0, 1.0], **change}
    with pytest.raises(error, match=message):
        minimize(**given)


@pytest.mark.parametrize("with_agreement", [False, True])
def test_numbers_of_the_nodes_do_not_matter(rng, with_agreement):
    """A graph in random order, which is renumbered, beside the same graph row by row."""
    n_rows, n_columns, n_labels = 60, 50, 4
    index = np.arange(n_rows * n_columns).reshape(n_rows, n_columns)
    right, down = (index[:, :-1], index[:, 1:]), (index[:-1], index[1:])
    edges = np.concatenate([np.column_stack([a.ravel(), b.ravel()]) for a, b in (right, down)])
    unary, weights = rng.random((index.size, n_labels)), rng.random(len(edges))
    agreement = rng.random((len(edges), n_labels)) / 10 if with_agreement else None
    labels, energy = minimize(unary, edges, weights, agreement=agreement)
    order = rng.permutation(index.size)
    number = np.argsort(order)
    assert np.abs(np.diff(number[edges], axis=1)).mean() > index.size / 10
    mixed, again = minimize(unary[order], number[edges], weights, agreement=agreement)
    np.testing.assert_array_equal(mixed, labels[order])
    assert again == pytest.approx(energy, rel=1e-12)
