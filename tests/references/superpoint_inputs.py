"""Slow, obvious re-implementation of the inputs of the superpoint transformer, array by array."""

from __future__ import annotations

import numpy as np

LIMIT, SMALL = 4.0, 0.05


def standardised(values, mean, deviation):
    """Return standardised, clipped features; 0 for missing ones."""
    return np.nan_to_num(np.clip((values - mean) / deviation, -LIMIT, LIMIT), nan=0.0)


def point_inputs(graph, scale, rows):
    """Return the inputs of some points; the last four features are intensity, red, green and blue."""
    owner = np.repeat(np.arange(len(graph.levels[0])), np.diff(graph.indptr))[rows]
    radius = np.maximum(graph.levels[0].radius, SMALL)[owner, None]
    values = graph.values[rows]
    first = values.shape[1] - 4
    known = np.isfinite(values[:, [0, first - 1, first, first + 1]])
    features = standardised(values, scale.means[0], scale.deviations[0])
    return np.hstack([features, known, graph.offset[rows] / radius, np.log(radius)]).astype(np.float32)


def edge_inputs(level):
    """Return the features of the edges of a level."""
    target, source = level.targets(), level.indices
    offset = level.centroid[source] - level.centroid[target]
    distance = np.linalg.norm(offset, axis=1, keepdims=True)
    direction = offset / np.maximum(distance, 1e-6)
    normals = level.normal[target], level.normal[source]
    angles = [np.abs((a * b).sum(axis=1)) for a, b in (normals, (normals[0], direction), (normals[1], direction))]
    sizes = (level.size[source] - level.size[target]) / 4
    features = [direction, np.log1p(distance), np.stack(angles, axis=1), sizes, np.arcsinh(offset[:, 2:])]
    return np.hstack(features).astype(np.float32)
