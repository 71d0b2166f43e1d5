"""Slow, obvious re-implementations of patches, and small labelled streets."""

from __future__ import annotations

import math

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters
from mlsroad_pipeline.papers.shared.patches.labelling import build_patches

GROUPS = {"ground": ["road"], "house": ["building"], "shrub": ["brushwood"], "vehicle": ["car"]}
SCHEME = ClassScheme.from_config(
    "planted",
    {
        "classes": {name: {"members": members, "asprs": 64} for name, members in GROUPS.items()},
        "ignore": [name for name in TAXONOMY if all(name not in members for members in GROUPS.values())],
    },
)


def pair_features(p, n, q, m):
    """Return theta, alpha, phi and the distance of two points with normals, as Rusu et al. 2009 define them."""
    line = q - p
    distance = math.sqrt(line @ line)
    if distance == 0:
        return 0.0, 0.0, 0.0, 0.0
    if abs(n @ line) < abs(m @ line):  # the source's normal is nearer to the line
        n, m, line = m, n, -line
    phi = n @ line / distance
    v = np.cross(line, n)
    if not v.any():
        return 0.0, 0.0, 0.0, distance
    v = v / math.sqrt(v @ v)
    w = np.cross(n, v)
    return math.atan2(w @ m, n @ m), v @ m, phi, distance


def fpfh(xyz, normals, radius, n_bins, use_distance):
    """Return the histograms, each of sum 1, point by point and pair by pair."""
    n, n_features = len(xyz), 4 if use_distance else 3
    gaps = np.sqrt(((xyz[:, None] - xyz[None]) ** 2).sum(axis=2))
    simple = np.zeros((n, n_features, n_bins))
    near = [[j for j in range(n) if j != i and gaps[i, j] <= radius] for i in range(n)]
    for i in range(n):
        for j in near[i]:
            theta, alpha, phi, distance = pair_features(xyz[i], normals[i], xyz[j], normals[j])
            places = [(theta + math.pi) / (2 * math.pi), (alpha + 1) / 2, (phi + 1) / 2, distance / radius]
            for f in range(n_features):
                simple[i, f, min(max(int(places[f] * n_bins), 0), n_bins - 1)] += 1 / len(near[i])
    out = np.zeros_like(simple)
    for i in range(n):
        total = sum((simple[j] / gaps[i, j] ** 2 for j in near[i] if gaps[i, j] > 0), np.zeros_like(simple[0]))
        sums = total.sum(axis=1, keepdims=True)
        out[i] = simple[i] + total / np.where(sums > 0, sums, 1)
    out = out.reshape(n, -1)
    return out / np.maximum(out.sum(axis=1, keepdims=True), 1e-12)


def leaves(world, size):
    """Return the integer coordinates of the leaf of each point and the places of the leaves, by dictionary."""
    cells = [tuple(math.floor(value / size) for value in point) for point in world]
    return cells, sorted(set(cells))


def votes(xyz, centroids, probabilities, radius):
    """Label each point by the patches around it, point by point (Luo et al. 2016, equation 8)."""
    best = probabilities.argmax(axis=1)
    labels, confidences = [], []
    for point in xyz:
        gaps = np.sqrt(((centroids - point) ** 2).sum(axis=1))
        voters = np.flatnonzero(gaps <= radius)
        if len(voters) == 0:
            voters = np.array([gaps.argmin()])
        counts = {c: ((best[voters] == c).sum(), probabilities[voters, c].sum(), -c) for c in set(best[voters])}
        winner = max(counts, key=counts.get)
        labels.append(winner)
        confidences.append(probabilities[voters, winner].mean())
    return np.array(labels), np.array(confidences)


def street(seed, *, colour=True, n=2500):
    """A road, a wall and a bush with their labels."""
    rng = np.random.default_rng(seed)
    road = np.column_stack([rng.uniform(0, 6, n), rng.uniform(0, 4, n), rng.normal(0, 0.01, n)])
    wall = np.column_stack([rng.uniform(0, 6, n), rng.normal(4.1, 0.01, n), rng.uniform(0.1, 2.5, n)])
    bush = rng.normal([3, 2, 0.9], 0.2, (n // 2, 3))
    label = np.repeat([TAXONOMY[name] for name in ("road", "building", "brushwood")], [n, n, n // 2])
    columns = {"label": label.astype(np.uint8), "core": np.concatenate([road, wall, bush])[:, 0] < 5.5}
    if colour:
        shade = np.repeat([[90, 90, 90], [200, 180, 150], [40, 120, 30]], [n, n, n // 2], axis=0)
        columns["rgb"] = np.clip(shade + rng.normal(0, 10, shade.shape), 0, 255).astype(np.uint8)
    return PointCloud(np.concatenate([road, wall, bush]), columns, source=f"street {seed}")


def prepare(cloud):
    return build_patches(cloud, find_ground(cloud, GroundParameters()), PatchParameters())
