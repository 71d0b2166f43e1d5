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
    last iteration and writes only its own matches, so that the result does not depend on the threads.

    Parameters
    ----------
    patches : Patches
        Labelled patches of more than K scenes; labels affect only the exhaustive search. Without colour, its weight is
        distributed over height and shape.
    n_matches : int, default 7
        Number K of matches. Larger values smooth the labels; time and memory grow with it.
    weights : CostWeights, optional
        Weights of the costs; those of the paper by default.
    search : SearchParameters, optional
        Parameters of the search; by default those of `SearchParameters()`.
    minority : sequence of int, optional
        Minority classes of the exhaustive search (luo2016: vehicle, cycas and light pole). By default those with less
        than half of an equal share of the labelled patches.
    seed : int, default 0
        Seed of the initialisation and of the node selection.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    MatchGraph
        The graph, in the order of `patches`.

    Raises
    ------
    DataError
        If the patches are of K scenes or fewer.
    ParameterError
        If `n_matches` or `n_threads` is below 1, or `seed` is negative.

    References
    ----------
    Luo et al.: Patch-Based Semantic Labeling of Road Scene Using Colorized Mobile LiDAR Point Clouds. IEEE
    Transactions on Intelligent Transportation Systems 17, 2016.
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
