"""Hierarchy of superpoints of a scene: points, three levels of superpoints, their features and neighbours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import N_LEVELS


@dataclass(frozen=True)
class Level:
    """Superpoints of a level."""

    centroid: NDArray[np.float32]  # Mean of the points, metres
    normal: NDArray[np.float32]  # Unit normal; 0 with fewer than three points
    size: NDArray[np.float32]  # Logarithms of length, surface, volume and number of points
    radius: NDArray[np.float32]  # Largest distance of a point from the centroid, metres
    values: NDArray[np.float32]  # Features; NaN where undefined
    parent: NDArray[np.int32]  # Superpoint of the next level; 0 throughout on the last level
    indptr: NDArray[np.int64]  # Start of the neighbours of each superpoint in `indices`
    indices: NDArray[np.int32]  # Neighbours; each superpoint is its own neighbour too
    histogram: NDArray[np.float32]  # Labelled points of each class; no columns without labels

    def __len__(self) -> int:
        """Return the number of superpoints."""
        return len(self.centroid)

    def targets(self) -> NDArray[np.int64]:
        """Return the superpoint whose neighbours `indices` are, for each edge."""
        return np.repeat(np.arange(len(self)), np.diff(self.indptr))


@dataclass(frozen=True)
class SuperpointGraph:
    """Points and superpoints of a scene."""

    # Points relative to the centroid of their superpoint of level 1, metres; sorted by superpoint
    offset: NDArray[np.float32]
    values: NDArray[np.float32]  # Features of the points; NaN where undefined or unknown
    indptr: NDArray[np.int64]  # Start of the points of each superpoint of level 1
    levels: tuple[Level, ...]  # Levels 1, 2 and 3

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the graph as plain arrays."""
        arrays: dict[str, NDArray] = {"offset": self.offset, "values": self.values, "indptr": self.indptr}
        for number, level in enumerate(self.levels, start=1):
            arrays |= {f"level_{number}.{field.name}": getattr(level, field.name) for field in fields(Level)}
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> SuperpointGraph:
        """Rebuild a graph from the arrays of `to_arrays`."""
        levels = (
            Level(**{field.name: np.asarray(arrays[f"level_{number}.{field.name}"]) for field in fields(Level)})
            for number in range(1, N_LEVELS + 1)
        )
        offset, values, indptr = (np.asarray(arrays[name]) for name in ("offset", "values", "indptr"))
        return cls(offset, values, indptr, tuple(levels))


def ranges(starts: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the concatenated ranges ``starts[i]`` to ``starts[i] + counts[i]``."""
    total = int(counts.sum())
    shifts = starts - np.cumsum(counts) + counts
    return np.arange(total) + np.repeat(shifts, counts)


def subgraph(graph: SuperpointGraph, keep: NDArray[np.bool_]) -> SuperpointGraph:
    """Return the graph of some superpoints of level 1, with their points and their ancestors.

    Attributes of the ancestors are those of the whole graph.
    """
    rows: NDArray[np.integer] = np.flatnonzero(keep)
    counts = np.diff(graph.indptr)[rows]
    points = ranges(graph.indptr[rows], counts)
    indptr = np.append(0, np.cumsum(counts))
    levels = []
    for level in graph.levels:
        parents, parent = np.unique(level.parent[rows], return_inverse=True)
        levels.append(_take(level, rows, parent))
        rows = parents
    return SuperpointGraph(graph.offset[points], graph.values[points], indptr, tuple(levels))


def _take(level: Level, rows: NDArray[np.integer], parent: NDArray[np.integer]) -> Level:
    new = np.full(len(level), -1, np.int32)
    new[rows] = np.arange(len(rows))
    counts = np.diff(level.indptr)[rows]
    sources = new[level.indices[ranges(level.indptr[rows], counts)]]
    targets = np.repeat(np.arange(len(rows)), counts)[sources >= 0]
    per_row = {
        name: getattr(level, name)[rows] for name in ("centroid", "normal", "size", "radius", "values", "histogram")
    }
    return Level(
        parent=parent.astype(np.int32),
        indptr=np.append(0, np.cumsum(np.bincount(targets, minlength=len(rows)))),
        indices=sources[sources >= 0],
        **per_row,
    )


def join_graphs(graphs: Sequence[SuperpointGraph]) -> SuperpointGraph:
    """Return one graph of several without edges between them."""
    return SuperpointGraph(
        np.concatenate([graph.offset for graph in graphs]),
        np.concatenate([graph.values for graph in graphs]),
        _join_pointers([graph.indptr for graph in graphs]),
        tuple(_join_level([graph.levels[i] for graph in graphs], i + 1 < N_LEVELS, graphs, i) for i in range(N_LEVELS)),
    )


def _join_level(levels: Sequence[Level], has_parent: bool, graphs: Sequence[SuperpointGraph], i: int) -> Level:
    first = np.cumsum([0, *(len(level) for level in levels)])
    above = np.cumsum([0, *(len(graph.levels[i + 1]) if has_parent else 0 for graph in graphs)])
    joined = {
        field.name: np.concatenate([getattr(level, field.name) for level in levels])
        for field in fields(Level)
        if field.name not in ("indptr", "indices", "parent")
    }
    return Level(
        parent=np.concatenate([level.parent + above[k] for k, level in enumerate(levels)]).astype(np.int32),
        indptr=_join_pointers([level.indptr for level in levels]),
        indices=np.concatenate([level.indices + first[k] for k, level in enumerate(levels)]).astype(np.int32),
        **joined,
    )


def _join_pointers(pointers: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    return np.append(0, np.cumsum(np.concatenate([np.diff(each) for each in pointers])))


def with_histograms(graph: SuperpointGraph, histogram: NDArray[np.integer]) -> SuperpointGraph:
    """Return the graph with the label histograms of level 1, summed over the hierarchy."""
    levels, counts = [], histogram.astype(np.float64)
    for i, level in enumerate(graph.levels):
        levels.append(replace(level, histogram=counts.astype(np.float32)))
        if i + 1 < N_LEVELS:
            n = len(graph.levels[i + 1])
            counts = np.stack([np.bincount(level.parent, column, minlength=n) for column in counts.T], axis=1)
    return replace(graph, levels=tuple(levels))
