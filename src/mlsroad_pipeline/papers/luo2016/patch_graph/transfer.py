"""Label transfer by matches in a trained graph (Luo et al. 2016, section III-C)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_arrays, check_column
from mlsroad_pipeline.papers.luo2016.patch_graph.costs import N_ABSOLUTE, CostWeights, PatchIndex, build_patch_index
from mlsroad_pipeline.papers.luo2016.patch_graph.iterations import (
    MatchGraph,
    SearchParameters,
    find_matches,
    make_chooser,
)
from mlsroad_pipeline.papers.luo2016.patch_graph.matching import check_matches, match_with_each_other
from mlsroad_pipeline.papers.luo2016.patch_graph.search import DescriptionCells
from mlsroad_pipeline.papers.shared.patches.table import UNKNOWN, Patches

_ARRAYS = ("matches", "labels", "rows", "objective", "coloured")


@dataclass(frozen=True, eq=False)
class TrainedGraph:
    """Match graph over labelled patches, the target of label transfer."""

    index: PatchIndex  # The labelled patches
    cells: DescriptionCells  # Their descriptor clusters
    matches: NDArray[np.int32]  # Their matches, as rows of the index
    labels: NDArray[np.int16]  # Their classes
    rows: NDArray[np.int64]  # Their rows in the training patches
    objective: NDArray[np.float64]  # Equation 1 after each iteration of training
    coloured: bool  # Whether the costs include colour

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the graph as named arrays."""
        own = {"matches": self.matches, "labels": self.labels, "rows": self.rows, "objective": self.objective}
        return {**self.index._asdict(), **self.cells._asdict(), **own, "coloured": np.array(self.coloured)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> TrainedGraph:
        """Rebuild a graph from the arrays of `to_arrays`."""
        check_arrays(arrays, (*PatchIndex._fields, *DescriptionCells._fields, *_ARRAYS), "a match graph")
        index = PatchIndex(**{name: np.asarray(arrays[name]) for name in PatchIndex._fields})
        cells = DescriptionCells(**{name: np.asarray(arrays[name]) for name in DescriptionCells._fields})
        own = {name: np.asarray(arrays[name]) for name in _ARRAYS[:-1]}
        return cls(index, cells, **own, coloured=bool(arrays["coloured"]))

    def without_colour(self, weights: CostWeights) -> TrainedGraph:
        """Return the graph for patches without colour, with its weight distributed over height and shape."""
        shared = (weights.colour + weights.height + weights.shape) / (weights.height + weights.shape)
        table, centres = self.index.table * np.float32(shared), self.cells.centres * np.float32(shared)
        for rows in (table, centres):
            rows[:, : N_ABSOLUTE - 1] = 0.0
        index, cells = self.index._replace(table=table), self.cells._replace(centres=centres)
        return replace(self, index=index, cells=cells, coloured=False)


def train_graph(
    patches: Patches,
    *,
    n_matches: int = 7,
    weights: CostWeights | None = None,
    search: SearchParameters | None = None,
    seed: int = 0,
    n_threads: int = 1,
) -> TrainedGraph:
    """Build the match graph of labelled patches for label transfer."""
    unlabelled = int((patches.label == UNKNOWN).sum())
    if unlabelled:
        raise DataError(f"{unlabelled} of {len(patches)} training patches have no label")
    graph, index, cells, order = match_with_each_other(
        patches,
        n_matches=n_matches,
        weights=weights or CostWeights(),
        search=search or SearchParameters(),
        minority=None,
        seed=seed,
        n_threads=n_threads,
    )
    coloured = patches.rgb is not None
    return TrainedGraph(index, cells, graph.matches, patches.label[order], order, graph.objective, coloured)


def match_patches(
    patches: Patches,
    graph: TrainedGraph,
    *,
    weights: CostWeights | None = None,
    search: SearchParameters | None = None,
    own_scene: ArrayLike | None = None,
    seed: int = 0,
    n_threads: int = 1,
) -> MatchGraph:
    """Match unlabelled patches with those of a trained graph.

    Edges lead only into the trained graph, which is fixed; there is no inverse enrichment.
    """
    search, weights = search or SearchParameters(), weights or CostWeights()
    n_matches = graph.matches.shape[1]
    width = graph.index.table.shape[1] - N_ABSOLUTE
    if patches.fpfh.shape[1] != width:
        raise DataError(f"the graph was trained on histograms of {width} bins, got {patches.fpfh.shape[1]}")
    apart = own_scene is not None
    check_matches(n_matches, len(graph.index.scene_starts) - 1, needed=n_matches + apart, seed=seed)
    if len(patches) == 0:
        return MatchGraph(np.empty((0, n_matches), np.int32), np.empty((0, n_matches), np.float32), np.zeros(1))
    if graph.coloured and patches.rgb is None:
        graph = graph.without_colour(weights)
    source, order, _ = build_patch_index(
        patches,
        weights,
        near_radius=search.propagation_radius,
        far_radius=search.search_radius,
        with_colour=graph.coloured,
    )
    if own_scene is not None:
        source = source._replace(scene=check_column(own_scene, len(patches), "own_scene")[order].astype(np.int32))
    unknown = np.full(len(patches), UNKNOWN, np.int16)
    if len(patches) * len(graph.labels) > search.exhaustive_budget:
        search = replace(search, exhaustive_budget=0)
    chooser = make_chooser(unknown, (), len(graph.labels), search, seed)
    matched = find_matches(
        source,
        graph.index,
        patches.height[order],
        graph.matches,
        n_matches,
        search,
        chooser,
        graph.cells,
        apart=apart,
        seed=seed,
        n_threads=n_threads,
    )
    matches, costs = np.empty_like(matched.matches), np.empty_like(matched.costs)
    matches[order], costs[order] = matched.matches, matched.costs
    return MatchGraph(matches, costs, matched.objective)


def class_probabilities(matched_labels: ArrayLike, n_classes: int) -> NDArray[np.float64]:
    """Return class probabilities from the labels of the matches (equation 6, with the weight 1 / rank squared)."""
    labels = np.asarray(matched_labels)
    if labels.size and not 0 <= labels.min() <= labels.max() < n_classes:
        raise DataError(f"classes of matches must be in 0..{n_classes - 1}, got {labels.min()}..{labels.max()}")
    weights = 1.0 / np.arange(1, labels.shape[1] + 1) ** 2
    weights /= weights.sum()
    votes = np.zeros((len(labels), n_classes))
    rows = np.arange(len(labels))
    for rank, weight in enumerate(weights.tolist()):
        votes[rows, labels[:, rank]] += weight
    return votes
