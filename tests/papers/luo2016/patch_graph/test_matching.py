"""The patch match graph against brute force, and what holds for every result."""

import functools

import numpy as np
import pytest
from helpers.match_graph import build_match_graph
from references.patch_graph import all_costs, match_cost, optimal_costs, planted_patches

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.papers.luo2016.patch_graph.costs import CostWeights, build_patch_index
from mlsroad_pipeline.papers.luo2016.patch_graph.iterations import SearchParameters
from mlsroad_pipeline.papers.luo2016.patch_graph.search import NodeChooser, minority_classes

MOVES_ALONE = SearchParameters(exhaustive_budget=0, n_costly=0, minority_share=0.0, n_probes=0)
PAPER = SearchParameters(exhaustive_budget=0, tolerance=0.0, promise=float("inf"), n_probes=0)


@functools.cache
def with_optimum(structured, coloured=True, seed=0):
    """Return 1,200 patches of ten scenes and the costs of their best matches."""
    patches = planted_patches(1200, 10, seed=seed, structured=structured, coloured=coloured)
    return patches, optimal_costs(all_costs(patches), patches.scene, patches.scene, 7)


def same_graph(a, b):
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize("coloured", [True, False])
@pytest.mark.parametrize("structured", [True, False])
def test_small_graphs_are_optimal(structured, coloured):
    patches, best = with_optimum(structured, coloured)
    found = build_match_graph(patches)
    np.testing.assert_allclose(found.costs, best, rtol=2e-5, atol=1e-6)
    assert found.objective[-1] == pytest.approx(best.sum(), rel=1e-5)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("structured", [True, False])
def test_the_search_of_the_paper_is_within_two_per_cent(structured, seed):
    patches, best = with_optimum(structured)
    objective = build_match_graph(patches, search=PAPER, seed=seed).objective
    assert best.sum() * (1 - 1e-6) <= objective[-1] <= 1.02 * best.sum()
    assert objective[0] > 1.5 * best.sum()  # the initialisation alone is far from it


def test_moves_alone_come_close_for_similar_scenes():
    patches, best = with_optimum(structured=True)
    assert build_match_graph(patches, search=MOVES_ALONE, seed=5).objective[-1] <= 1.02 * best.sum()


@pytest.mark.parametrize("search", [MOVES_ALONE, PAPER, SearchParameters()])
def test_constraints_hold_and_costs_are_those_of_the_matches(search):
    patches = planted_patches(300, 6, seed=1)
    found = build_match_graph(patches, n_matches=4, search=search)
    scenes = patches.scene[found.matches]
    assert found.matches.shape == found.costs.shape == (300, 4)
    assert found.matches.dtype == np.int32
    assert (scenes != patches.scene[:, None]).all()
    assert all(len(set(row)) == 4 for row in scenes.tolist())
    assert (np.diff(found.costs, axis=1) >= 0).all()
    assert (np.diff(found.objective) <= 0).all()
    assert found.objective[-1] == pytest.approx(found.costs.sum(dtype=np.float64), rel=1e-6)
    for u in range(0, 300, 13):
        for v, cost in zip(found.matches[u], found.costs[u], strict=True):
            assert cost == pytest.approx(match_cost(patches, u, v), rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("seed", [0, 7])
def test_threads_do_not_change_a_byte_and_seeds_do(seed):
    patches = planted_patches(700, 9, seed=2)
    one = build_match_graph(patches, search=MOVES_ALONE, seed=seed)
    assert same_graph(one, build_match_graph(patches, search=MOVES_ALONE, seed=seed, n_threads=3))
    assert not same_graph(one, build_match_graph(patches, search=MOVES_ALONE, seed=seed + 1))


def test_optimal_graphs_do_not_depend_on_place_order_or_seed():
    patches = planted_patches(400, 9, seed=3)
    found = build_match_graph(patches)
    order = np.random.default_rng(0).permutation(400)
    shuffled = build_match_graph(patches.take(order), seed=5)
    moved = build_match_graph(patches.with_columns(centroid=patches.centroid + [500_000.0, 5_800_000.0, 300.0]))
    np.testing.assert_array_equal(order[shuffled.matches], found.matches[order])
    np.testing.assert_array_equal(moved.matches, found.matches)


def test_exact_copies_in_other_scenes_are_found_at_no_cost():
    one = planted_patches(60, 1, seed=4)
    copies = [one.with_columns(scene=np.full(60, s), centroid=one.centroid + [0, 50.0 * s, 0]) for s in range(9)]
    parts = {name: np.concatenate([c.to_arrays()[name] for c in copies]) for name in copies[0].to_arrays()}
    found = build_match_graph(type(one).from_arrays(parts), search=MOVES_ALONE)
    assert found.objective[-1] == 0
    assert (found.matches % 60 == np.tile(np.arange(60), 9)[:, None]).all()


def test_balls_are_found_in_the_index():
    patches = planted_patches(500, 3, seed=6)
    index, order, _ = build_patch_index(patches, CostWeights(), near_radius=0.7, far_radius=2.1, with_colour=True)
    for radius, rows in ((0.7, index.near), (2.1, index.far)):
        for u in range(0, 500, 41):
            runs = [np.arange(a, b) for a, b in rows[index.cell[u]]]
            near = {v for v in np.concatenate(runs) if np.linalg.norm(index.xyz[v] - index.xyz[u]) <= radius}
            distance = np.linalg.norm(patches.centroid[order] - patches.centroid[order[u]], axis=1)
            inside = (distance <= radius) & (index.scene == index.scene[u])
            assert near == set(np.flatnonzero(inside))


def test_weights_decide_what_a_match_is():
    patches = planted_patches(300, 5, seed=8)
    by_height = build_match_graph(patches, n_matches=2, weights=CostWeights(colour=0, shape=0, height=1))
    gaps = np.abs(patches.height[by_height.matches] - patches.height[:, None])
    best = optimal_costs(
        np.abs(patches.height[:, None] - patches.height[None]).astype(float), patches.scene, patches.scene, 2
    )
    np.testing.assert_allclose(np.sort(gaps, axis=1), best, atol=1e-6)


def test_minority_classes_have_less_than_half_of_an_equal_share():
    labels = np.repeat(np.array([0, 1, 2, -1], np.int16), [600, 300, 100, 5000])
    assert minority_classes(labels) == [2]
    assert minority_classes(labels[:0]) == []


def test_exhaustive_search_prefers_costly_and_rare_patches_and_takes_none_twice():
    labels = np.repeat(np.array([0, 1], np.int16), [900, 100])
    chooser = NodeChooser(labels, minority=[1], minority_share=0.1, n_costly=20, seed=0)
    costs = np.full((1000, 2), 0.01, np.float32)
    costs[:100] = 10.0
    first = chooser.choose(costs)
    assert (first < 100).sum() >= 15 and (first >= 900).sum() >= 10
    chosen = [first, *(chooser.choose(costs) for _ in range(60))]
    assert len(np.concatenate(chosen)) == len(np.unique(np.concatenate(chosen))) == 1000
    assert chooser.exhausted


def test_too_few_scenes_say_what_to_change():
    with pytest.raises(DataError, match=r"at least 8 scenes, got 7.*shorter scenes.*lower n_matches"):
        build_match_graph(planted_patches(70, 7))
    assert build_match_graph(planted_patches(70, 7), n_matches=6).matches.shape == (70, 6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_matches": 0}, "n_matches must be at least 1, got 0"),
        ({"seed": -1}, "seed must not be negative, got -1"),
        ({"n_threads": 0}, "n_threads must be at least 1, got 0"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(ParameterError, match=message):
        build_match_graph(planted_patches(90, 9), **options)


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        (CostWeights, {"colour": -0.1}, "weight of colour .* got -0.1"),
        (CostWeights, {"height": 0, "shape": 0}, "must not both be 0"),
        (CostWeights, {"max_height": 0}, "max_height must be"),
        (SearchParameters, {"search_radius": -1}, "search_radius must be"),
        (SearchParameters, {"n_iterations": 0}, "n_iterations must be at least 1, got 0"),
        (SearchParameters, {"promise": 0.5}, "promise must be at least 1, got 0.5"),
        (SearchParameters, {"tolerance": -1.0}, "tolerance must be a finite number >= 0, got -1.0"),
        (SearchParameters, {"minority_share": 2}, r"minority_share must be in \[0, 1\], got 2"),
    ],
)
def test_bad_parameters_are_named(kind, options, message):
    with pytest.raises(ParameterError, match=message):
        kind(**options)


def test_one_patch_per_scene_is_enough():
    found = build_match_graph(planted_patches(8, 8))
    assert sorted(map(len, map(set, found.matches.tolist()))) == [7] * 8
