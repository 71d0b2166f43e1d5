"""Label transfer by matches in a trained graph (Luo et al. 2016, section III-C)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, field, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_arrays, check_at_least, check_column, check_positive
from mlsroad_pipeline.papers.luo2016.patch_graph.costs import N_ABSOLUTE, CostWeights, PatchIndex, build_patch_index
from mlsroad_pipeline.papers.luo2016.patch_graph.iterations import (
    MatchGraph,
    SearchParameters,
    check_matches,
    find_matches,
    make_chooser,
    match_with_each_other,
)
from mlsroad_pipeline.papers.luo2016.patch_graph.search import DescriptionCells
from mlsroad_pipeline.papers.shared.patches.labelling import main_axis_stations
from mlsroad_pipeline.papers.shared.patches.table import UNKNOWN, Patches, edges_between

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


def cut_scenes(patches: Patches, length: float) -> Patches:
    """Cut scenes by station into shorter scenes of about equal length.

    Matches come from different scenes; short scenes allow a patch more matches within one street. Patches without
    stations are cut along the main horizontal axis of their scene.
    """
    check_positive(length, "scene_length")
    pieces = np.empty(len(patches), np.int32)
    n_pieces = 0
    for scene in np.unique(patches.scene):
        members = np.flatnonzero(patches.scene == scene)
        if patches.station is None:
            along = main_axis_stations(patches.centroid[members])
        else:
            along = patches.station[members] - patches.station[members].min()
        count = max(1, round(float(along.max()) / length))
        places = np.minimum((along / max(along.max(), length) * count).astype(np.int32), count - 1)
        pieces[members] = n_pieces + places
        n_pieces += count
    return patches.with_columns(scene=pieces)


def thin_scenes(
    patches: Patches, edges: NDArray[np.int32], *, n_patches: int, seed: int
) -> tuple[Patches, NDArray[np.int32]]:
    """Thin scenes with too many patches by a random sample stratified by class."""
    check_at_least(n_patches, 1, "max_patches")
    random = np.random.default_rng(seed)
    # Every k-th patch in the order of scene, class and a random key is a sample stratified by class.
    order = np.lexsort((random.random(len(patches)), patches.label, patches.scene))
    sizes = np.bincount(patches.scene)
    rank = np.arange(len(patches)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    share = np.minimum(n_patches / np.maximum(sizes, 1), 1.0)[patches.scene[order]]
    drawn = np.zeros(len(patches), bool)
    drawn[order] = np.floor((rank + 1) * share + 1e-9) > np.floor(rank * share + 1e-9)
    if drawn.all():
        return patches, edges
    return patches.take(np.flatnonzero(drawn)), edges_between(edges, drawn)


@dataclass(frozen=True)
class PatchGraphParameters:
    """Parameters of the match graph."""

    # Number K of matches per patch, all from different scenes (luo2016: 7). Larger values smooth the labels.
    n_matches: int = 7
    # Length into which training scenes are cut, metres (luo2016: 10). More than K scenes are required.
    scene_length: float = 10.0
    # Maximum patches per scene, sampled in proportion to the classes. Bounds the time and the size of the model.
    max_patches: int = 3000
    seed: int = 2016  # Seed of the samples and of the search
    weights: CostWeights = field(default_factory=CostWeights)  # Weights of the costs
    search: SearchParameters = field(default_factory=SearchParameters)  # Parameters of the search

    def __post_init__(self) -> None:
        for name, kind in (("weights", CostWeights), ("search", SearchParameters)):
            if isinstance(getattr(self, name), Mapping):  # from configuration
                object.__setattr__(self, name, _from_mapping(kind, getattr(self, name), name))
        check_positive(self.scene_length, "patch_graph.scene_length")
        for name, least in (("n_matches", 1), ("max_patches", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise ParameterError(f"patch_graph.{name} must be at least {least}, got {getattr(self, name)!r}")


def _from_mapping(kind: type, values: Mapping[str, Any], name: str) -> Any:
    unknown = sorted(set(values) - {entry.name for entry in fields(kind)})
    if unknown:
        raise ParameterError(f"patch_graph.{name} has no parameter {', '.join(unknown)}")
    return kind(**values)


@dataclass(frozen=True, eq=False)
class PatchGraphClassifier:
    """Patch classifier by label transfer with the 3-D patch match graph."""

    graph: TrainedGraph
    n_classes: int
    weights: CostWeights
    search: SearchParameters

    @classmethod
    def fit(
        cls,
        patches: Patches,
        edges: NDArray[np.int32],
        n_classes: int,
        *,
        parameters: PatchGraphParameters | None = None,
        n_threads: int = 1,
    ) -> PatchGraphClassifier:
        """Build the match graph of labelled patches."""
        chosen = parameters or PatchGraphParameters()
        if len(patches) and patches.label.max() >= n_classes:
            raise DataError(f"patches have class {patches.label.max()}, but the scheme has {n_classes} classes")
        used, _ = select_training(patches, edges, chosen)
        graph = train_graph(
            used,
            n_matches=chosen.n_matches,
            weights=chosen.weights,
            search=chosen.search,
            seed=chosen.seed,
            n_threads=n_threads,
        )
        return cls(graph, n_classes, weights=chosen.weights, search=chosen.search)

    def describe(self) -> dict[str, Any]:
        """Return the objective (equation 1) after each iteration, and the size of the graph."""
        return {"objective": self.graph.objective.tolist(), "graph_nodes": len(self.graph.labels)}

    def predict_proba(self, patches: Patches, edges: NDArray[np.int32]) -> NDArray[np.float64]:
        """Return the class probabilities of the patches of one scene (equation 6)."""
        del edges
        matched = match_patches(patches, self.graph, weights=self.weights, search=self.search)
        return class_probabilities(self.graph.labels[matched.matches], self.n_classes)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the learned parameters as named arrays."""
        return {
            **self.graph.to_arrays(),
            "n_classes": np.array(self.n_classes),
            "weights": np.array(astuple(self.weights)),
            # Arrays of a model are finite, and a promise is at least 1: 0 stands for infinity.
            "search": np.nan_to_num(np.array(astuple(self.search), np.float64), posinf=0.0),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild the classifier from the arrays of `to_arrays`."""
        graph = TrainedGraph.from_arrays(arrays)
        check_arrays(arrays, ("n_classes", "weights", "search"), "a patch graph")
        weights = CostWeights(*np.asarray(arrays["weights"]).tolist())
        return cls(graph, int(arrays["n_classes"]), weights=weights, search=_search(arrays["search"]))


def select_training(
    patches: Patches, edges: NDArray[np.int32], parameters: PatchGraphParameters
) -> tuple[Patches, NDArray[np.int32]]:
    """Cut the training scenes to the given length and thin them."""
    short = cut_scenes(patches, parameters.scene_length)
    return thin_scenes(short, edges, n_patches=parameters.max_patches, seed=parameters.seed)


def _search(values: NDArray) -> SearchParameters:
    kinds = [type(value) for value in astuple(SearchParameters())]
    search = dict(zip((entry.name for entry in fields(SearchParameters)), np.asarray(values).tolist(), strict=True))
    search["promise"] = search["promise"] or np.inf
    return SearchParameters(**{name: kind(search[name]) for name, kind in zip(search, kinds, strict=True)})
