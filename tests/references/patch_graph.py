"""Slow, obvious re-implementations of the patch match graph and its refinement."""

import itertools
import math

import numpy as np

from mlsroad_pipeline.papers.shared.patches.table import Patches


def planted_patches(n, n_scenes, *, seed=0, structured=True, coloured=True, n_bins=16):
    """Return patches whose descriptors vary smoothly in space, alike in all scenes, or are pure noise."""
    rng = np.random.default_rng(seed)
    centroid = rng.random((n, 3)) * [10.0, 10.0, 4.0]
    fpfh, rgb = rng.gamma(0.5, size=(n, n_bins)), rng.random((n, 3))
    if structured:
        waves = np.sin(centroid @ (rng.random((3, n_bins + 3)) * 1.5) + rng.random(n_bins + 3) * 6)
        fpfh = np.exp(2 * waves[:, :n_bins] + 0.3 * rng.standard_normal((n, n_bins)))
        rgb = np.clip(0.5 + 0.4 * waves[:, n_bins:] + 0.05 * rng.standard_normal((n, 3)), 0, 1)
    fpfh /= fpfh.sum(axis=1, keepdims=True)
    scene = rng.permutation(np.arange(n) % n_scenes)
    label = (centroid[:, 0] // 2.5).astype(int)
    return Patches(fpfh, rgb if coloured else None, centroid[:, 2], centroid, scene, label)


def match_cost(patches, u, v, colour=0.3, height=0.3, shape=0.4, max_height=20.0):
    """Return equation 2 as it is printed, colours in [0, 1]."""
    if patches.rgb is None:
        height, shape = height * (colour + height + shape) / (height + shape), shape * (1 + colour / (height + shape))
    total = height * abs(float(patches.height[u]) - float(patches.height[v])) / max_height
    for k in range(3 if patches.rgb is not None else 0):
        total += colour * abs(float(patches.rgb[u, k]) - float(patches.rgb[v, k]))
    for a, b in zip(patches.fpfh[u].astype(float), patches.fpfh[v].astype(float), strict=True):
        if a + b > 0:
            total += shape * (a - b) ** 2 / (a + b)
    return total


def all_costs(patches, **weights):
    """Return the costs between all patches, by broadcasting."""
    colour, height, shape, top = (weights.get(k, d) for k, d in (("colour", 0.3), ("height", 0.3), ("shape", 0.4), ("max_height", 20.0)))  # fmt: skip
    f, h = patches.fpfh.astype(np.float64), patches.height.astype(np.float64)
    if patches.rgb is None:
        share = (colour + height + shape) / (height + shape)
        costs = np.zeros((len(h), len(h)))
        height, shape = height * share, shape * share
    else:
        c = patches.rgb.astype(np.float64)
        costs = colour * sum(np.abs(c[:, None, k] - c[None, :, k]) for k in range(3))
    costs = costs + height * np.abs(h[:, None] - h[None]) / top
    for k in range(f.shape[1]):
        a, b = f[:, None, k], f[None, :, k]
        costs += shape * np.divide((a - b) ** 2, a + b, out=np.zeros_like(costs), where=a + b > 0)
    return costs


def optimal_costs(costs, source_scene, target_scene, n_matches):
    """Return the K smallest costs to different scenes: equation 1 falls apart into one choice per patch."""
    scenes = np.unique(target_scene)
    best = np.stack([costs[:, target_scene == s].min(axis=1) for s in scenes], axis=1)
    best[source_scene[:, None] == scenes[None]] = np.inf
    return np.sort(best, axis=1)[:, :n_matches]


def field_energy(labels, probabilities, rgb, edges, initial, *, lam, beta, gamma, floor, grass, road):
    """Return equations 9 to 11, edge by edge; the penalty holds where either order of the ends meets the condition."""
    energy = sum(1 - math.log(max(probabilities[u, labels[u]], floor)) for u in range(len(labels)))
    for u, v in edges:
        if labels[u] == labels[v]:
            continue
        special = any(
            (initial[a] == grass and initial[b] != road) or (initial[a] == road and initial[b] != grass)
            for a, b in ((u, v), (v, u))
        )
        far = sum((float(rgb[u][k]) - float(rgb[v][k])) ** 2 for k in range(3)) if rgb is not None else 0.0
        energy += lam * (gamma if special else math.exp(-beta * far))
    return energy


def lowest_energy(n_classes, n, energy):
    """Return the least energy of all labellings."""
    return min(energy(labels) for labels in itertools.product(range(n_classes), repeat=n))
