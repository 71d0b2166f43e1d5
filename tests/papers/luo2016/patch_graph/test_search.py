"""Descriptor clusters and the search initialised by them, against brute force."""

import numpy as np
import pytest
from helpers.match_graph import build_match_graph
from references.patch_graph import all_costs, match_cost, optimal_costs, planted_patches

from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import match_patches, train_graph
from mlsroad_pipeline.papers.luo2016.patch_graph.costs import CostWeights, block_costs, bounded_cost, weigh_descriptors
from mlsroad_pipeline.papers.luo2016.patch_graph.iterations import SearchParameters
from mlsroad_pipeline.papers.luo2016.patch_graph.search import build_description_cells

CELLS = SearchParameters(exhaustive_budget=0, n_costly=0, minority_share=0.0)
EVERYWHERE = SearchParameters(exhaustive_budget=0, n_costly=0, minority_share=0.0, n_probes=10_000)


@pytest.mark.parametrize("n_bins", [1, 15, 16])
def test_costs_of_a_block_are_those_of_the_pairs(n_bins):
    patches = planted_patches(60, 3, seed=2, n_bins=n_bins)
    table = weigh_descriptors(patches, CostWeights(), with_colour=True)
    table[7, 4:] = table[9, 4:] = 0.0  # empty bins on both sides count nothing
    found = np.full(60, np.nan, np.float32)
    block_costs(table, 7, table[:50].T.copy(), 50, found)
    expected = [bounded_cost(table, 7, table, v, np.float32(np.inf)) for v in range(50)]
    np.testing.assert_allclose(found[:50], expected, rtol=2e-5, atol=1e-6)
    assert np.isnan(found[50:]).all() and found[7] == 0
    full = weigh_descriptors(patches, CostWeights(), with_colour=True)
    assert bounded_cost(full, 3, full, 4, np.float32(np.inf)) == pytest.approx(match_cost(patches, 3, 4), rel=1e-4)


@pytest.mark.parametrize("n", [1, 2, 500])
def test_every_patch_is_in_the_cell_of_its_cheapest_centre(n):
    table = weigh_descriptors(planted_patches(n, 1, seed=5), CostWeights(), with_colour=True)
    cells = build_description_cells(table, seed=3)
    assert len(cells.centres) == np.ceil(np.sqrt(n)) and cells.cell_starts[-1] == n
    assert np.array_equal(np.sort(cells.members), np.arange(n))
    for c in range(len(cells.centres)):
        members = cells.members[cells.cell_starts[c] : cells.cell_starts[c + 1]]
        assert (np.diff(members) > 0).all()
        for v in members[::7]:
            costs = [bounded_cost(table, v, cells.centres, k, np.float32(np.inf)) for k in range(len(cells.centres))]
            assert costs[c] <= min(costs) + 1e-5
    again = build_description_cells(table, seed=3, n_threads=3)
    assert all(np.array_equal(a, b) for a, b in zip(cells, again, strict=True))


@pytest.mark.parametrize("structured", [True, False])
def test_the_search_starts_near_the_optimum_and_ends_at_it_where_all_cells_are_searched(structured):
    patches = planted_patches(1500, 9, seed=1, structured=structured)
    best = optimal_costs(all_costs(patches), patches.scene, patches.scene, 7).sum()
    few, all_of_them = (build_match_graph(patches, search=search).objective for search in (CELLS, EVERYWHERE))
    assert best * (1 - 1e-6) <= few[-1] <= 1.02 * best
    assert all_of_them[0] == pytest.approx(best, rel=1e-5)  # before any move
    if structured:
        assert few[0] <= 1.05 * best


def test_transfer_by_cells_is_within_two_per_cent_of_the_optimum_with_and_without_colour():
    whole = planted_patches(2400, 10, seed=4)
    known, new = whole.take(np.flatnonzero(whole.scene < 9)), whole.take(np.flatnonzero(whole.scene == 9))
    graph = train_graph(known, search=CELLS)
    for patches, labelled in ((new, known), (new.with_columns(rgb=None), known.with_columns(rgb=None))):
        together = [np.concatenate([getattr(p, name) for p in (patches, labelled)]) for name in ("fpfh", "height")]
        both = planted_patches(len(together[1]), 1).with_columns(
            fpfh=together[0],
            height=together[1],
            rgb=None if patches.rgb is None else np.concatenate([patches.rgb, labelled.rgb]),
        )
        costs = all_costs(both)[: len(new), len(new) :]
        best = optimal_costs(costs, np.full(len(new), -1), labelled.scene, 7).sum()
        found = match_patches(patches, graph, search=CELLS)
        assert best * (1 - 1e-5) <= found.costs.sum() <= 1.02 * best
        exact = match_patches(patches, graph)  # so few pairs that all are compared
        assert exact.costs.sum() == pytest.approx(best, rel=1e-5)


def test_threads_do_not_change_a_byte():
    patches = planted_patches(900, 9, seed=2)
    one, three = (build_match_graph(patches, search=CELLS, n_threads=n) for n in (1, 3))
    assert all(np.array_equal(a, b) for a, b in zip(one, three, strict=True))
