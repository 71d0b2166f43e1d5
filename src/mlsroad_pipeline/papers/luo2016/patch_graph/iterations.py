"""Iterations of the 3-D patch match graph (Luo et al. 2016, section III-B.2)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive
from mlsroad_pipeline.algorithms.geometry.threads import check_threads, run_in_chunks
from mlsroad_pipeline.papers.luo2016.patch_graph import moves, search
from mlsroad_pipeline.papers.luo2016.patch_graph.costs import CostWeights, PatchIndex, build_patch_index
from mlsroad_pipeline.papers.luo2016.patch_graph.search import (
    DescriptionCells,
    NodeChooser,
    build_description_cells,
    minority_classes,
    search_cells,
)
from mlsroad_pipeline.papers.shared.patches.table import Patches


@dataclass(frozen=True)
class SearchParameters:
    """Parameters of the search for matches."""

    # R_pro, the radius of propagation between neighbours, metres. Time grows with about its fourth power.
    propagation_radius: float = 0.5
    # R_loc, the radius of the local search around a match, metres. Larger values find more per iteration and take
    # longer.
    search_radius: float = 1.0
    # Propagation searches around a match of a neighbour only if that match would cost the patch less than `promise`
    # times the match to replace. Infinity reproduces the paper: several times slower, with the same objective one or
    # two iterations earlier.
    promise: float = 1.5
    n_iterations: int = 50  # Maximum number of iterations
    # The search ends when an iteration lowers the objective by at most this fraction. 0 stops at no change, as in the
    # paper.
    tolerance: float = 1e-3
    # Maximum height difference of patches of the same height in the initialisation, metres
    height_tolerance: float = 0.1
    # Fraction of the patches of minority classes in the exhaustive search of each iteration
    minority_share: float = 0.001
    n_costly: int = 10  # Patches with costly best matches in the exhaustive search of each iteration
    # Maximum pairs compared in an iteration for additional costly patches; 0 limits them to `n_costly`. If the number
    # of patches is below about its square root, all are searched at once and the graph is optimal.
    exhaustive_budget: int = 50_000_000
    # Descriptor clusters searched for each patch after the initialisation. Larger values find more and take longer. 0
    # reproduces the paper: three times slower, with a 2 % worse objective.
    n_probes: int = 8

    def __post_init__(self) -> None:
        for name in ("propagation_radius", "search_radius"):
            check_positive(getattr(self, name), name)
        check_at_least(self.n_iterations, 1, "n_iterations")
        if not self.promise >= 1:
            raise ParameterError(f"promise must be at least 1, got {self.promise!r}")
        for name in ("tolerance", "height_tolerance", "n_costly", "exhaustive_budget", "n_probes"):
            if not np.isfinite(getattr(self, name)) or getattr(self, name) < 0:
                raise ParameterError(f"{name} must be a finite number >= 0, got {getattr(self, name)!r}")
        if not 0 <= self.minority_share <= 1:
            raise ParameterError(f"minority_share must be in [0, 1], got {self.minority_share!r}")


class MatchGraph(NamedTuple):
    """Directed match graph of patches."""

    matches: NDArray[np.int32]  # Matches of each patch, cheapest first; all from different scenes, none from its own
    costs: NDArray[np.float32]  # Costs of the matches (equation 2)
    objective: NDArray[np.float64]  # Equation 1 after the initialisation and after each iteration


def make_chooser(
    labels: NDArray[np.int16], minority: Sequence[int], n_targets: int, search: SearchParameters, seed: int
) -> NodeChooser:
    """Return the selection of nodes for the exhaustive search."""
    n_costly = max(search.n_costly, search.exhaustive_budget // n_targets)
    return NodeChooser(labels, minority=minority, minority_share=search.minority_share, n_costly=n_costly, seed=seed)


class _State:
    """Graphs of the last and the current iteration, and flags of the edges not yet followed."""

    def __init__(
        self,
        source: PatchIndex,
        heights: NDArray[np.float32],
        target: PatchIndex,
        graph: NDArray[np.int32] | None,
        n_matches: int,
        search: SearchParameters,
        cells: DescriptionCells,
        apart: bool,
        n_threads: int,
    ) -> None:
        n = len(source.table)
        self.source, self.target, self.heights, self.graph = source, target, heights, graph
        self.search, self.n_threads, self.promise = search, n_threads, np.float32(search.promise)
        self.same, self.apart, self.cells = graph is None, apart, cells
        self.matches, self.costs = np.empty((n, n_matches), np.int32), np.empty((n, n_matches), np.float32)
        self.new_matches, self.new_costs = np.empty_like(self.matches), np.empty_like(self.costs)
        # Edges not yet followed by enrichment and local search, and by propagation.
        self.fresh, self.unspread = np.ones((n, n_matches), bool), np.ones((n, n_matches), bool)
        self.incoming = np.zeros(n + 1, np.int64), np.empty(0, np.int32)
        self.links_fresh = self.fresh if graph is None else np.zeros(graph.shape, bool)

    def initialise(self, seed: int) -> None:
        def run(first: int, last: int) -> None:
            moves.initialise(
                self.source, self.heights, self.target, self.apart, self.search.height_tolerance, seed, first, last,
                self.matches, self.costs,
            )  # fmt: skip
            if self.search.n_probes:
                search_cells(
                    self.source, self.target, self.cells, self.apart, self.search.n_probes, first, last, self.matches,
                    self.costs,
                )  # fmt: skip

        run_in_chunks(run, len(self.matches), n_threads=self.n_threads)

    def enrich_and_search(self) -> None:
        if self.same:
            self.incoming = moves.incoming_edges(self.matches, self.fresh)
        links = self.matches if self.graph is None else self.graph

        def run(first: int, last: int) -> None:
            moves.enrich_and_search(
                self.source, self.target, self.apart, links, self.links_fresh, *self.incoming, self.matches,
                self.costs, self.fresh, self.search.search_radius, first, last, self.new_matches, self.new_costs,
            )  # fmt: skip

        run_in_chunks(run, len(self.matches), n_threads=self.n_threads)
        moves.mark_changes(self.matches, self.new_matches, self.fresh, False)
        moves.mark_changes(self.matches, self.new_matches, self.unspread, True)
        self._swap()

    def propagate_and_exhaust(self, nodes: NDArray[np.int32]) -> None:
        def propagate(first: int, last: int) -> None:
            moves.propagate(
                self.source, self.target, self.matches, self.costs, self.unspread, self.search.propagation_radius,
                self.promise, first, last, self.new_matches, self.new_costs,
            )  # fmt: skip

        def outwards(first: int, last: int) -> None:
            search.search_all_targets(
                self.source, self.target, self.apart, nodes, first, last, self.new_matches, self.new_costs
            )

        def inwards(first: int, last: int) -> None:
            search.search_to_nodes(self.source, nodes, first, last, self.new_matches, self.new_costs)

        run_in_chunks(propagate, len(self.matches), n_threads=self.n_threads)
        run_in_chunks(outwards, len(nodes), n_threads=self.n_threads)
        if self.same and len(nodes) < len(self.matches):
            run_in_chunks(inwards, len(self.matches), n_threads=self.n_threads)
        moves.mark_changes(self.matches, self.new_matches, self.fresh, True)
        moves.mark_changes(self.matches, self.new_matches, self.unspread, False)
        self._swap()

    def _swap(self) -> None:
        self.matches, self.new_matches = self.new_matches, self.matches
        self.costs, self.new_costs = self.new_costs, self.costs

    def objective(self) -> float:
        return float(self.costs.sum(dtype=np.float64))


def find_matches(
    source: PatchIndex,
    target: PatchIndex,
    heights: NDArray[np.float32],
    graph: NDArray[np.int32] | None,
    n_matches: int,
    search: SearchParameters,
    chooser: NodeChooser,
    cells: DescriptionCells,
    *,
    apart: bool,
    seed: int,
    n_threads: int,
) -> MatchGraph:
    """Search matches from the patches of one index to those of another or of the same index."""
    check_threads(n_threads)
    state = _State(source, heights, target, graph, n_matches, search, cells, apart, n_threads)
    state.initialise(seed)
    objective = [state.objective()]
    for _ in range(search.n_iterations):
        state.enrich_and_search()
        state.propagate_and_exhaust(chooser.choose(state.costs))
        objective.append(state.objective())
        if chooser.exhausted or objective[-2] - objective[-1] <= search.tolerance * objective[-1]:
            break
    by_cost = np.argsort(state.costs, axis=1, kind="stable")
    ranked = np.take_along_axis(state.matches, by_cost, 1), np.take_along_axis(state.costs, by_cost, 1)
    return MatchGraph(*ranked, np.array(objective))


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
    """Build a match graph (see `build_match_graph`); return it with its index, clusters and the order of the index."""
    n_scenes = len(np.unique(patches.scene))
    check_matches(n_matches, n_scenes, needed=n_matches + 1, seed=seed)
    check_threads(n_threads)
    index, order, _ = build_patch_index(
        patches, weights, near_radius=search.propagation_radius, far_radius=search.search_radius,
        with_colour=patches.rgb is not None,
    )  # fmt: skip
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
    """Check the parameters of a match graph and the number of its scenes."""
    check_at_least(n_matches, 1, "n_matches")
    if seed < 0:
        raise ParameterError(f"seed must not be negative, got {seed!r}")
    if n_scenes < needed:
        raise DataError(
            f"{n_matches} matches from different scenes need patches of at least {needed} scenes, got {n_scenes}: "
            "cut the training survey into shorter scenes, add training scenes, or lower n_matches"
        )
