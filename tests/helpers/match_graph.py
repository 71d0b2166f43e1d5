"""Match graph of labelled patches in their own order, for comparison with exhaustive searches."""

import numpy as np

from mlsroad_pipeline.papers.luo2016.patch_graph.costs import CostWeights
from mlsroad_pipeline.papers.luo2016.patch_graph.iterations import MatchGraph, SearchParameters, match_with_each_other


def build_match_graph(patches, *, n_matches=7, weights=None, search=None, minority=None, seed=0, n_threads=1):
    """Match each patch with patches of other scenes (Luo et al. 2016, equation 1)."""
    graph, _, _, order = match_with_each_other(
        patches,
        n_matches=n_matches,
        weights=weights or CostWeights(),
        search=search or SearchParameters(),
        minority=minority,
        seed=seed,
        n_threads=n_threads,
    )
    matches, costs = np.empty_like(graph.matches), np.empty_like(graph.costs)
    matches[order], costs[order] = order[graph.matches], graph.costs
    return MatchGraph(matches, costs, graph.objective)
