"""The 3-D patch match graph: K good matches from different scenes for every patch (Luo et al. 2016, section III-B)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cell_grid import check_threads, run_in_chunks
from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.patch_graph import exhaustive, moves
from mlsroad_pipeline.algorithms.patch_graph.costs import CostWeights
from mlsroad_pipeline.algorithms.patch_graph.exhaustive import NodeChooser, minority_classes
from mlsroad_pipeline.algorithms.patch_graph.patch_index import PatchIndex, build_patch_index
from mlsroad_pipeline.algorithms.patches import Patches
from mlsroad_pipeline.algorithms.validation import check_positive


@dataclass(frozen=True)
class SearchParameters:
    """How matches are searched.

    Parameters
    ----------
    propagation_radius : float, default 0.5
        R_pro in metres: how far neighbours pass on what they have found. Work grows with about its fourth power.
    search_radius : float, default 1.0
        R_loc in metres: how far around a match the local search looks. Larger finds more in an iteration and takes
        longer.
    promise : float, default 1.5
        Propagation looks around a neighbour's match only where that match itself, as one of the patch at hand, costs
        less than this times the match to be beaten. Infinity is as in the paper: several times slower, with the same
        objective after an iteration or two fewer.
    n_iterations : int, default 50
        Most iterations.
    tolerance : float, default 0.001
        The search ends when an iteration lowers the objective by less than this share of it; at 0 when it stands
        still, as in the paper.
    height_tolerance : float, default 0.1
        Difference in metres up to which patches count as of the same height in the initialisation.
    minority_share : float, default 0.001
        Share of the patches of minority classes that each iteration searches exhaustively.
    n_costly : int, default 10
        Patches that each iteration searches exhaustively because their best match is costly.
    exhaustive_budget : int, default 50_000_000
        More costly patches are searched, as long as an iteration compares no more than this many pairs for them. Up to
        about its root of patches all are searched at once, and the graph is optimal; 0 leaves it at `n_costly`.

    Raises
    ------
    ParameterError
        If a value is outside its domain.
    """

    propagation_radius: float = 0.5
    search_radius: float = 1.0
    promise: float = 1.5
    n_iterations: int = 50
    tolerance: float = 1e-3
    height_tolerance: float = 0.1
    minority_share: float = 0.001
    n_costly: int = 10
    exhaustive_budget: int = 50_000_000

    def __post_init__(self) -> None:
        for name in ("propagation_radius", "search_radius"):
            check_positive(getattr(self, name), name)
        if self.n_iterations < 1:
            raise ParameterError(f"n_iterations must be at least 1, got {self.n_iterations!r}")
        if not self.promise >= 1:
            raise ParameterError(f"promise must be at least 1, got {self.promise!r}")
        for name in ("tolerance", "height_tolerance", "n_costly", "exhaustive_budget"):
            if not np.isfinite(getattr(self, name)) or getattr(self, name) < 0:
                raise ParameterError(f"{name} must be a finite number >= 0, got {getattr(self, name)!r}")
        if not 0 <= self.minority_share <= 1:
            raise ParameterError(f"minority_share must be in [0, 1], got {self.minority_share!r}")


class MatchGraph(NamedTuple):
    """Directed matches of patches.

    Attributes
    ----------
    matches : ndarray of int32, shape (n, K)
        The patches that each patch is matched with, cheapest first; no two from one scene, none from its own.
    costs : ndarray of float32, shape (n, K)
        Costs of the matches, equation 2.
    objective : ndarray of float64, shape (iterations + 1,)
        Equation 1 after the initialisation and after every iteration.
    """

    matches: NDArray[np.int32]
    costs: NDArray[np.float32]
    objective: NDArray[np.float64]


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
    n_scenes = len(np.unique(patches.scene))
    check_matches(n_matches, n_scenes, needed=n_matches + 1, seed=seed)
    search, weights = search or SearchParameters(), weights or CostWeights()
    index, order, _ = build_patch_index(
        patches,
        weights,
        near_radius=search.propagation_radius,
        far_radius=search.search_radius,
        with_colour=patches.rgb is not None,
    )
    labels = patches.label[order]
    rare = minority_classes(labels) if minority is None else minority
    chooser = make_chooser(labels, rare, len(patches), search, seed)
    found = find_matches(
        index, patches.height[order], index, None, n_matches, search, chooser, seed=seed, n_threads=n_threads
    )
    matches, costs = np.empty_like(found.matches), np.empty_like(found.costs)
    matches[order], costs[order] = order[found.matches], found.costs
    return MatchGraph(matches, costs, found.objective)


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
    if n_matches < 1:
        raise ParameterError(f"n_matches must be at least 1, got {n_matches!r}")
    if seed < 0:
        raise ParameterError(f"seed must not be negative, got {seed!r}")
    if n_scenes < needed:
        raise DataError(
            f"{n_matches} matches from different scenes need patches of at least {needed} scenes, got {n_scenes}: "
            "cut the training survey into shorter scenes, add training scenes, or lower n_matches"
        )


def make_chooser(
    labels: NDArray[np.int16], minority: Sequence[int], n_targets: int, search: SearchParameters, seed: int
) -> NodeChooser:
    """Return the choice of nodes for the exhaustive search that the parameters ask for.

    Parameters
    ----------
    labels : ndarray of int16, shape (n,)
        Classes of the nodes.
    minority : sequence of int
        Minority classes.
    n_targets : int
        Patches that a node is compared with.
    search : SearchParameters
        How matches are searched.
    seed : int
        Seed of the choice.

    Returns
    -------
    NodeChooser
        The choice.
    """
    n_costly = max(search.n_costly, search.exhaustive_budget // n_targets)
    return NodeChooser(labels, minority=minority, minority_share=search.minority_share, n_costly=n_costly, seed=seed)


def find_matches(
    source: PatchIndex,
    heights: NDArray[np.float32],
    target: PatchIndex,
    graph: NDArray[np.int32] | None,
    n_matches: int,
    search: SearchParameters,
    chooser: NodeChooser,
    *,
    seed: int,
    n_threads: int,
) -> MatchGraph:
    """Search matches from the patches of one index to those of another, or of the same one.

    Parameters
    ----------
    source, target : PatchIndex
        Where matches start and end.
    heights : ndarray of float32, shape (n,)
        Heights of the source's patches, metres.
    graph : ndarray of int32, shape (m, K), or None
        Matches of the target that forward enrichment follows; None where source and target are the same, which
        matches in both directions.
    n_matches : int
        K.
    search : SearchParameters
        How matches are searched.
    chooser : NodeChooser
        Chooses the nodes of the exhaustive search.
    seed : int
        Seed of the initialisation.
    n_threads : int
        Threads.

    Returns
    -------
    MatchGraph
        The matches, in the order of the indices.
    """
    check_threads(n_threads)
    n, same = len(source.table), graph is None
    matches, costs = np.empty((n, n_matches), np.int32), np.empty((n, n_matches), np.float32)

    def start(first: int, last: int) -> None:
        moves.initialise(source, heights, target, same, search.height_tolerance, seed, first, last, matches, costs)

    run_in_chunks(start, n, n_threads=n_threads)
    # Edges that have not been followed yet: by enrichment and local search, and by propagation.
    fresh, unspread = np.ones((n, n_matches), bool), np.ones((n, n_matches), bool)
    nobody, still = np.zeros(n + 1, np.int64), np.zeros((len(target.table), 0 if same else n_matches), bool)
    objective = [float(costs.sum(dtype=np.float64))]
    promise = np.float32(search.promise)
    spare = np.empty_like(matches), np.empty_like(costs)
    for _ in range(search.n_iterations):
        indptr, incoming = moves.incoming_edges(matches, fresh) if same else (nobody, matches[:0, 0].copy())
        links, links_fresh = (matches, fresh) if graph is None else (graph, still)

        def look_around(
            first: int, last: int, links=links, links_fresh=links_fresh, indptr=indptr, incoming=incoming,
            old=(matches, costs, fresh), new=spare,
        ) -> None:  # fmt: skip
            moves.enrich_and_look_around(
                source, target, same, links, links_fresh, indptr, incoming, *old, search.search_radius, first, last,
                *new,
            )  # fmt: skip

        run_in_chunks(look_around, n, n_threads=n_threads)
        moves.mark_changes(matches, spare[0], fresh, False)
        moves.mark_changes(matches, spare[0], unspread, True)
        matches, costs, spare = *spare, (matches, costs)

        def pass_on(first: int, last: int, old=(matches, costs, unspread), new=spare) -> None:
            moves.propagate(source, target, *old, search.propagation_radius, promise, first, last, *new)

        run_in_chunks(pass_on, n, n_threads=n_threads)
        _search_exhaustively(source, target, same, chooser.choose(costs), *spare, n_threads)
        moves.mark_changes(matches, spare[0], fresh, True)
        moves.mark_changes(matches, spare[0], unspread, False)
        matches, costs, spare = *spare, (matches, costs)
        objective.append(float(costs.sum(dtype=np.float64)))
        if chooser.exhausted or objective[-2] - objective[-1] <= search.tolerance * objective[-1]:
            break
    by_cost = np.argsort(costs, axis=1, kind="stable")
    ranked = np.take_along_axis(matches, by_cost, 1), np.take_along_axis(costs, by_cost, 1)
    return MatchGraph(*ranked, np.array(objective))


def _search_exhaustively(
    source: PatchIndex,
    target: PatchIndex,
    same: bool,
    nodes: NDArray[np.int32],
    matches: NDArray[np.int32],
    costs: NDArray[np.float32],
    n_threads: int,
) -> None:
    def outwards(first: int, last: int) -> None:
        exhaustive.search_all_targets(source, target, same, nodes, first, last, matches, costs)

    def inwards(first: int, last: int) -> None:
        exhaustive.offer_to_all(source, nodes, first, last, matches, costs)

    run_in_chunks(outwards, len(nodes), n_threads=n_threads)
    if same and len(nodes) < len(matches):
        run_in_chunks(inwards, len(matches), n_threads=n_threads)
