"""The 3-D patch match graph: K good matches from different scenes for every patch (Luo et al. 2016, section III-B)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.algorithms.geometry.cell_grid import check_threads
from mlsroad_pipeline.algorithms.patch_graph.costs import CostWeights
from mlsroad_pipeline.algorithms.patch_graph.description_cells import DescriptionCells, build_description_cells
from mlsroad_pipeline.algorithms.patch_graph.exhaustive import minority_classes
from mlsroad_pipeline.algorithms.patch_graph.iterations import (
    MatchGraph,
    SearchParameters,
    find_matches,
    make_chooser,
)
from mlsroad_pipeline.algorithms.patch_graph.patch_index import PatchIndex, build_patch_index
from mlsroad_pipeline.algorithms.patches.extraction import Patches

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
    """Match every patch with K patches of other scenes so that the summed cost is small, equation 1.

    The moves of section III-B.2 are applied to the edges that the last iteration changed; a node reads the last
    iteration's graph and writes its own matches, so that the result does not depend on the threads.

    Parameters
    ----------
    patches : Patches
        Labelled patches of more than K scenes; labels serve the choice of the exhaustive search only. Without colour
        its weight goes to height and shape.
    n_matches : int, default 7
        K. More votes smooth the labels; time and memory grow with it.
    weights : CostWeights, optional
        Weights of the costs; the paper's by default.
    search : SearchParameters, optional
        How matches are searched; the paper's values by default.
    minority : sequence of int, optional
        Minority classes of the exhaustive search (the paper's are vehicle, cycas and light pole); by default those
        with less than half of an equal share of the labelled patches.
    seed : int, default 0
        Seed of the initialisation and of the choice of nodes for the exhaustive search.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    MatchGraph
        ``matches``, ``costs`` and ``objective``.

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
    found, _, _, order = match_with_each_other(
        patches,
        n_matches=n_matches,
        weights=weights or CostWeights(),
        search=search or SearchParameters(),
        minority=minority,
        seed=seed,
        n_threads=n_threads,
    )
    matches, costs = np.empty_like(found.matches), np.empty_like(found.costs)
    matches[order], costs[order] = order[found.matches], found.costs
    return MatchGraph(matches, costs, found.objective)


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
    """Build a match graph, see `build_match_graph`, and keep the index that it was searched in.

    Parameters
    ----------
    patches : Patches
        Labelled patches of more than K scenes.
    n_matches : int
        K.
    weights : CostWeights
        Weights of the costs.
    search : SearchParameters
        How matches are searched.
    minority : sequence of int, optional
        Minority classes of the exhaustive search.
    seed : int
        The seed.
    n_threads : int
        Threads.

    Returns
    -------
    graph : MatchGraph
        The graph, in the order of the index.
    index : PatchIndex
        The sorted patches.
    cells : DescriptionCells
        Their cells of alike descriptions.
    order : ndarray of int64, shape (n,)
        Place in `patches` of each sorted patch.

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
    found = find_matches(
        index, index, patches.height[order], None, n_matches, search, chooser, cells,
        apart=True, seed=seed, n_threads=n_threads,
    )  # fmt: skip
    return found, index, cells, order


def check_matches(n_matches: int, n_scenes: int, *, needed: int, seed: int) -> None:
    """Refuse parameters that no match graph can be built with.

    Parameters
    ----------
    n_matches : int
        K.
    n_scenes : int
        How many scenes there are.
    needed : int
        How many there must be.
    seed : int
        The seed.

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
