"""Inputs of the network from graphs of superpoints: standardised features, relative positions and edge features."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.superpoint_transformer.building import ATTRIBUTES
from mlsroad_pipeline.algorithms.models.superpoint_transformer.graph import Level, SuperpointGraph, ranges
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import N_LEVELS

_NEAREST = np.float32(1e-6)
"""Least distance in metres that directions are divided by."""
_QUARTER = np.float32(0.25)


@njit(cache=True, nogil=True, error_model="numpy")
def write_points(
    values: NDArray[np.float32],
    offset: NDArray[np.float32],
    rows: NDArray[np.int64],
    owner: NDArray[np.int64],
    scale: tuple[NDArray[np.float32], NDArray[np.float32]],
    limit: np.float32,
    radius: NDArray[np.float32],
    flags: NDArray[np.int64],
    out: NDArray[np.float32],
) -> None:
    """Write standardised features, flags of known ones, relative position and radius of some points."""
    n_features, n_flags = values.shape[1], len(flags)
    mean, deviation = scale
    for i in range(len(rows)):
        row, own = out[i], rows[i]
        for k in range(n_features):
            value = (values[own, k] - mean[k]) / deviation[k]
            row[k] = np.float32(0.0) if np.isnan(value) else min(max(value, -limit), limit)
        for k in range(n_flags):
            row[n_features + k] = np.float32(1.0) if np.isfinite(values[own, flags[k]]) else np.float32(0.0)
        for k in range(3):
            row[n_features + n_flags + k] = offset[own, k] / radius[owner[i], 0]
        row[n_features + n_flags + 3] = radius[owner[i], 1]


@njit(cache=True, nogil=True, error_model="numpy")
def write_edges(
    centroid: NDArray[np.float32],
    normal: NDArray[np.float32],
    size: NDArray[np.float32],
    target: NDArray[np.int64],
    source: NDArray[np.int64],
    out: NDArray[np.float32],
) -> None:
    """Write direction, distance, angles, ratios of sizes and height of edges; distance and height are in metres."""
    for e in range(len(target)):
        t, s, row = target[e], source[e], out[e]
        x, y, z = centroid[s, 0] - centroid[t, 0], centroid[s, 1] - centroid[t, 1], centroid[s, 2] - centroid[t, 2]
        distance = np.sqrt(x * x + y * y + z * z)
        reach = max(distance, _NEAREST)
        row[0], row[1], row[2], row[3] = x / reach, y / reach, z / reach, distance
        between, first, second = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for k in range(3):
            between += normal[t, k] * normal[s, k]
            first += normal[t, k] * row[k]
            second += normal[s, k] * row[k]
        row[4], row[5], row[6] = abs(between), abs(first), abs(second)
        for k in range(4):
            row[7 + k] = (size[s, k] - size[t, k]) * _QUARTER
        row[11] = z


EDGE_FEATURES = 12
"""Features of an edge: direction (3), distance, angles of normals and direction (3), ratios of sizes (4), height."""

_LIMIT = 4.0
_SMALL = 0.05
"""Least radius in metres that positions are divided by."""


@dataclass(frozen=True)
class Scale:
    """Means and standard deviations of the features of points and of each level."""

    # means, deviations: one row for the points, then one for each level
    means: tuple[NDArray[np.float32], ...]
    deviations: tuple[NDArray[np.float32], ...]

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the scale as plain arrays."""
        return {
            f"scale.{kind}_{i}": row
            for kind, rows in (("mean", self.means), ("deviation", self.deviations))
            for i, row in enumerate(rows)
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Scale:
        """Rebuild a scale from the arrays of `to_arrays`."""
        means, deviations = (
            tuple(np.asarray(arrays[f"scale.{kind}_{i}"]) for i in range(N_LEVELS + 1))
            for kind in ("mean", "deviation")
        )
        return cls(means, deviations)


def find_scale(graphs: Sequence[SuperpointGraph]) -> Scale:
    """Return the means and deviations of the finite features of training graphs; each graph counts the same."""
    means, deviations = [], []
    for i in range(N_LEVELS + 1):
        tables = [graph.values if i == 0 else graph.levels[i - 1].values for graph in graphs]
        first, second = np.zeros(tables[0].shape[1]), np.zeros(tables[0].shape[1])
        weight = np.zeros(tables[0].shape[1])
        for table in tables:
            values, known = np.nan_to_num(table.astype(np.float64)), np.isfinite(table)
            share = known.any(axis=0) / np.maximum(known.sum(axis=0), 1)
            first += values.sum(axis=0) * share
            second += (values**2).sum(axis=0) * share
            weight += known.any(axis=0)
        mean = first / np.maximum(weight, 1)
        variance = np.maximum(second / np.maximum(weight, 1) - mean**2, 0.0)
        means.append(mean.astype(np.float32))
        deviations.append(np.where(variance > 0, np.sqrt(variance), 1.0).astype(np.float32))
    return Scale(tuple(means), tuple(deviations))


@dataclass(frozen=True)
class LevelInputs:
    """Inputs of a level."""

    nodes: NDArray[np.float32]  # Features and positions of the superpoints
    edges: NDArray[np.float32]  # Features of the edges, sorted by target
    # target, source: superpoints of the edges
    target: NDArray[np.int64]
    source: NDArray[np.int64]
    parent: NDArray[np.int64]  # Superpoint of the next level
    histogram: NDArray[np.float32]  # Labelled points of each class


@dataclass(frozen=True)
class Inputs:
    """Inputs of the network."""

    points: NDArray[np.float32]  # Features and positions of the points
    owner: NDArray[np.int64]  # Superpoint of level 1 of each point, ascending
    levels: tuple[LevelInputs, ...]  # Levels 1, 2 and 3


def prepare_inputs(graph: SuperpointGraph, scale: Scale, points: NDArray[np.int64] | None = None) -> Inputs:
    """Return the inputs of the network."""
    scales, n_features = (scale.means[0], scale.deviations[0]), graph.values.shape[1]
    if any(row.shape != (n_features,) for row in scales):
        raise DataError(f"the model's scale does not fit the {n_features} features of a point: the model is damaged")
    rows = np.arange(len(graph.offset)) if points is None else points
    owner = np.repeat(np.arange(len(graph.levels[0])), np.diff(graph.indptr))[rows].astype(np.int64)
    radius = np.maximum(graph.levels[0].radius, _SMALL)
    first = n_features - len(ATTRIBUTES)
    flags = np.array([0, first - 1, first, first + 1])
    values = np.empty((len(rows), n_features + len(flags) + 4), np.float32)
    reach = np.stack([radius, np.log(radius)], axis=1)
    write_points(graph.values, graph.offset, rows, owner, scales, np.float32(_LIMIT), reach, flags, values)
    return Inputs(values, owner, tuple(_level_inputs(graph.levels, i, scale) for i in range(N_LEVELS)))


def n_inputs(scale: Scale) -> list[int]:
    """Return the number of inputs of a point and of a superpoint of each level."""
    points, *levels = (len(mean) for mean in scale.means)
    return [points + 8, *(n + 6 for n in levels)]


def even_points(graph: SuperpointGraph, n_points: int) -> NDArray[np.int64]:
    """Return at most `n_points` evenly spaced points of each superpoint of level 1; they are in spatial order."""
    counts = np.diff(graph.indptr)
    taken = np.minimum(counts, n_points)
    place = ranges(np.zeros(len(counts), np.int64), taken)
    owner = np.repeat(np.arange(len(counts)), taken)
    return graph.indptr[owner] + (place * counts[owner]) // taken[owner]


def drawn_points(graph: SuperpointGraph, n_points: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return at most `n_points` random points of each superpoint of level 1, ascending."""
    counts = np.diff(graph.indptr)
    owner = np.repeat(np.arange(len(counts)), counts)
    order = np.lexsort((rng.random(len(owner)), owner))
    place = np.arange(len(owner)) - graph.indptr[owner]
    return np.sort(order[place < n_points])


def _standardised(
    values: NDArray[np.float32], mean: NDArray[np.float32], deviation: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return standardised, clipped features; 0 for missing ones."""
    return np.nan_to_num(np.clip((values - mean) / deviation, -_LIMIT, _LIMIT), nan=0.0)


def _level_inputs(levels: Sequence[Level], i: int, scale: Scale) -> LevelInputs:
    level = levels[i]
    n = len(level)
    place, reach = np.zeros((n, 3), np.float32), np.zeros((n, 1), np.float32)
    if i + 1 < N_LEVELS:
        reach = np.maximum(levels[i + 1].radius, _SMALL)[level.parent, None]
        place = (level.centroid - levels[i + 1].centroid[level.parent]) / reach
    else:
        reach = np.maximum(level.radius, _SMALL)[:, None]
    known = np.stack([np.isfinite(level.values[:, 0]), np.isfinite(level.values).mean(axis=1)], axis=1)
    values = _standardised(level.values, scale.means[i + 1], scale.deviations[i + 1])
    target, source = level.targets(), level.indices.astype(np.int64)
    return LevelInputs(
        np.hstack([values, known, place, np.log(reach)]).astype(np.float32),
        _edge_features(level, target, source),
        target,
        source,
        level.parent.astype(np.int64),
        level.histogram,
    )


def _edge_features(level: Level, target: NDArray[np.int64], source: NDArray[np.int64]) -> NDArray[np.float32]:
    features = np.empty((len(target), EDGE_FEATURES), np.float32)
    write_edges(level.centroid, level.normal, level.size, target, source, features)
    features[:, 3], features[:, 11] = np.log1p(features[:, 3]), np.arcsinh(features[:, 11])
    return features
