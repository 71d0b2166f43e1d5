"""3-D patch match graph with K matches from different scenes for each patch (Luo et al. 2016, section III-B)."""

from collections.abc import Sequence

import numpy as np

from mlsroad_pipeline.papers.luo2016.patch_graph.costs import CostWeights
from mlsroad_pipeline.papers.luo2016.patch_graph.iterations import MatchGraph, SearchParameters, match_with_each_other
from mlsroad_pipeline.papers.shared.patches.table import Patches

__all__ = ["CostWeights", "MatchGraph", "SearchParameters", "build_match_graph"]


def build_match_graph(
    patches: Patches,
    *,
    n_matches: int = 7,
    weights: CostWeights | None = None,
    search: SearchParameters | None = None,
    minority: Sequence[int] | None = None,
    seed: int = 0,
    n_threads: int = 1,
) -> MatchGraph:
    """Match each patch with K patches of other scenes, approximately minimising the summed cost (equation 1).

    The moves of section III-B.2 are applied to edges that changed in the last iteration. A node reads the graph of the
    last iteration and writes only its own matches, so that the result does not depend on the threads. By default,
    minority classes of the exhaustive search have less than half of an equal share of the labelled patches (luo2016:
    vehicle, cycas and light pole).
    """
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
