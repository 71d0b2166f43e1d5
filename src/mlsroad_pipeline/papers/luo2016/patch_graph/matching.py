"""3-D patch match graph with K matches from different scenes for each patch (Luo et al. 2016, section III-B)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.algorithms.geometry.threads import check_threads
from mlsroad_pipeline.papers.luo2016.patch_graph.costs import CostWeights, PatchIndex, build_patch_index
from mlsroad_pipeline.papers.luo2016.patch_graph.iterations import (
    MatchGraph,
    SearchParameters,
    find_matches,
    make_chooser,
)
from mlsroad_pipeline.papers.luo2016.patch_graph.search import (
    DescriptionCells,
    build_description_cells,
    minority_classes,
)
from mlsroad_pipeline.papers.shared.patches.table import Patches

__all__ = [
    "CostWeights",
    "MatchGraph",
    "SearchParameters",
    "build_match_graph",
    "check_matches",
    "match_with_each_other",
]


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


def match_with_each_other(
    patches: Patches,
    *,
    n_matches: int,
    weights: CostWeights,
    search: SearchParameters,
    minority: Sequence[int] | None,
    seed: int,
    n_threads: int,
) -> tuple[MatchGraph, PatchIndex, DescriptionCells, NDArray[np.int64]]:
    """Build a match graph (see `build_match_graph`) and return it with its search index.

    Parameters
    ----------
    patches : Patches
        Labelled patches of more than K scenes.
    n_matches : int
        K.
    weights : CostWeights
        Weights of the costs.
    search : SearchParameters
        Parameters of the search.
    minority : sequence of int, optional
        Minority classes of the exhaustive search.
    seed : int
        Seed of the search.
    n_threads : int
        Threads.

    Returns
    -------
    graph : MatchGraph
        The graph, in the order of the index.
    index : PatchIndex
        The sorted patches.
    cells : DescriptionCells
        Their descriptor clusters.
    order : ndarray of int64, shape (n,)
        Row in `patches` of each sorted patch.

    Raises
    ------
    DataError
        If the patches are of K scenes or fewer.
    ParameterError
        If `n_matches` or `n_threads` is below 1, or `seed` is negative.
    """
    n_scenes = len(np.unique(patches.scene))
    check_matches(n_matches, n_scenes, needed=n_matches + 1, seed=seed)
    check_threads(n_threads)
    index, order, _ = build_patch_index(
        patches,
        weights,
        near_radius=search.propagation_radius,
        far_radius=search.search_radius,
        with_colour=patches.rgb is not None,
    )
    cells = build_description_cells(index.table, seed=seed, n_threads=n_threads)
    labels = patches.label[order]
    rare = minority_classes(labels) if minority is None else minority
    chooser = make_chooser(labels, rare, len(patches), search, seed)
    graph = find_matches(
        index, index, patches.height[order], None, n_matches, search, chooser, cells,
        apart=True, seed=seed, n_threads=n_threads,
    )  # fmt: skip
    return graph, index, cells, order


def check_matches(n_matches: int, n_scenes: int, *, needed: int, seed: int) -> None:
    """Check the parameters of a match graph.

    Parameters
    ----------
    n_matches : int
        K.
    n_scenes : int
        Number of scenes.
    needed : int
        Required number of scenes.
    seed : int
        Seed of the search.

    Raises
    ------
    DataError
        If there are too few scenes.
    ParameterError
        If `n_matches` is below 1 or `seed` is negative.
    """
    check_at_least(n_matches, 1, "n_matches")
    if seed < 0:
        raise ParameterError(f"seed must not be negative, got {seed!r}")
    if n_scenes < needed:
        raise DataError(
            f"{n_matches} matches from different scenes need patches of at least {needed} scenes, got {n_scenes}: "
            "cut the training survey into shorter scenes, add training scenes, or lower n_matches"
        )
