"""Changes of training scenes: views of virtual scanners, and changes of the graphs of superpoints in each step."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.superpoint_transformer.building import ATTRIBUTES
from mlsroad_pipeline.algorithms.models.superpoint_transformer.graph import Level, SuperpointGraph, subgraph
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inputs import Scale
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import AugmentationParameters
from mlsroad_pipeline.algorithms.stages import inliers

SCANNER_HEIGHTS = (1.6, 2.6)
"""Range of the height of a virtual scanner above the ground, metres."""


def cut_view(
    scene: PointCloud, height: NDArray[np.floating], parameters: AugmentationParameters, rng: np.random.Generator
) -> PointCloud:
    """Return the points of a scene that a virtual scanner with a limited view upwards records.

    The scanner stands on the ground of the scene, or drives along it: the distance is then measured across the main
    direction of the scene. A random share of the points is dropped besides.
    """
    plan = scene.xyz[:, :2].astype(np.float64)
    low = np.flatnonzero(np.abs(np.nan_to_num(height, nan=np.inf)) < 0.3)  # metres: the scanner stands on the ground
    stand = plan[rng.choice(low)] if len(low) else plan.mean(axis=0)
    offset = plan - stand
    if rng.random() < 0.5:
        _, axes = np.linalg.eigh(np.cov(offset.T)) if len(plan) > 1 else (None, np.eye(2))
        distance = np.abs(offset @ axes[:, 0])
    else:
        distance = np.linalg.norm(offset, axis=1)
    lowest, highest = parameters.elevation
    slope = np.tan(np.radians(rng.uniform(lowest, highest)))
    seen = ~(height > rng.uniform(*SCANNER_HEIGHTS) + slope * distance)
    seen &= rng.random(len(scene)) >= rng.uniform(0, parameters.thin)
    return scene.select(seen) if (seen & inliers(scene)).any() else scene


def change_graph(
    graph: SuperpointGraph, scale: Scale, parameters: AugmentationParameters, rng: np.random.Generator
) -> SuperpointGraph:
    """Return a changed graph: superpoints dropped, rotated, mirrored, stretched, noisy, attributes hidden."""
    p = parameters
    keep = rng.random(len(graph.levels[0])) >= rng.uniform(0, p.drop)
    graph = subgraph(graph, keep) if keep.any() else graph
    turn = _turn(p, rng)
    stretch = rng.uniform(1 - p.stretch, 1 + p.stretch, 2)[[0, 0, 1]]
    values = _noisy(graph.values, scale.deviations[0], p.jitter, rng)
    for columns, share in ((slice(0, 1), p.hide_intensity), (slice(1, 4), p.hide_colour)):
        if rng.random() < share:
            values[:, values.shape[1] - len(ATTRIBUTES) :][:, columns] = np.nan
    levels = (_changed(level, turn, stretch, scale.deviations[i + 1], p.jitter, rng)
              for i, level in enumerate(graph.levels))  # fmt: skip
    offset = (graph.offset @ turn * stretch).astype(np.float32)
    return replace(graph, offset=offset, values=values, levels=tuple(levels))


def _turn(p: AugmentationParameters, rng: np.random.Generator) -> NDArray[np.float64]:
    angle, mirrored = rng.uniform(0, 2 * np.pi), rng.random() < 0.5
    if not p.rotate:
        return np.eye(3)
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) * ([-1, 1, 1] if mirrored else [1, 1, 1])


def _changed(
    level: Level,
    turn: NDArray[np.float64],
    stretch: NDArray[np.float64],
    deviation: NDArray[np.float32],
    jitter: float,
    rng: np.random.Generator,
) -> Level:
    return replace(
        level,
        centroid=(level.centroid @ turn * stretch).astype(np.float32),
        normal=(level.normal @ turn).astype(np.float32),
        values=_noisy(level.values, deviation, jitter, rng),
    )


def _noisy(
    values: NDArray[np.float32], deviation: NDArray[np.float32], jitter: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Return the features with noise, a part of it common to the scene: sensors differ as a whole."""
    common = rng.standard_normal(values.shape[1], dtype=np.float32) * np.float32(jitter)
    own = rng.standard_normal(values.shape, dtype=np.float32) * np.float32(jitter)
    return values + (own + common) * deviation


def crop_graph(graph: SuperpointGraph, radius: float, rng: np.random.Generator) -> SuperpointGraph:
    """Return the superpoints within a radius, in plan, of a random labelled superpoint."""
    level = graph.levels[0]
    labelled = np.flatnonzero(level.histogram.sum(axis=1) > 0)
    middle = level.centroid[rng.choice(labelled), :2]
    return subgraph(graph, np.linalg.norm(level.centroid[:, :2] - middle, axis=1) <= radius)
