"""Inputs of the network: images and measures of objects, and their augmentation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.features.accumulation_images import Images, draw_images
from mlsroad_pipeline.papers.luo2019.jointnet.cleaning import isolated_points
from mlsroad_pipeline.papers.luo2019.jointnet.measures import measure_objects
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import (
    N_INTENSITY,
    N_MEASURES,
    VIEWS,
    AugmentationParameters,
    InputParameters,
)

_FEW = 8
"""Minimum number of points after thinning; objects below it keep all points."""


@dataclass(frozen=True)
class Points:
    """Objects as flat arrays."""

    xyz: NDArray[np.float64]  # Points, object by object, metres
    indptr: NDArray[np.int64]  # Start of the points of each object
    intensity: NDArray[np.float64]  # Intensity of each point; arbitrary where unknown
    known: NDArray[np.bool_]  # Objects whose intensity is known

    @property
    def owner(self) -> NDArray[np.int64]:
        """Return the object of each point."""
        return np.repeat(np.arange(len(self.indptr) - 1), np.diff(self.indptr))

    def turned(self, angle: NDArray[np.float64] | float) -> Points:
        """Rotate objects about z."""
        each = np.broadcast_to(angle, (len(self.indptr) - 1,))[self.owner]
        low = self.xyz[self.indptr[:-1]][self.owner]  # rotation about a point of the object preserves precision
        x, y, z = (self.xyz - low).T
        cos, sin = np.cos(each), np.sin(each)
        return replace(self, xyz=np.column_stack([x * cos - y * sin, x * sin + y * cos, z]))

    def kept(self, keep: NDArray[np.bool_]) -> Points:
        """Remove points, except from objects that would keep fewer than 8."""
        left = np.add.reduceat(keep.astype(np.int64), self.indptr[:-1])
        keep = keep | (left < _FEW)[self.owner]
        counts = np.add.reduceat(keep.astype(np.int64), self.indptr[:-1])
        indptr = np.append(0, np.cumsum(counts)).astype(np.int64)
        return Points(self.xyz[keep], indptr, self.intensity[keep], self.known)


def augment(points: Points, parameters: AugmentationParameters, rng: np.random.Generator) -> Points:
    """Return randomly augmented objects."""
    p, n = parameters, len(points.indptr) - 1
    if p.rotate:
        points = points.turned(rng.uniform(0, 2 * np.pi, n))
        mirror = rng.choice([-1.0, 1.0], n)[points.owner]
        points = replace(points, xyz=points.xyz * np.column_stack([np.ones_like(mirror), mirror, np.ones_like(mirror)]))
    if p.drop:
        points = points.kept(rng.random(len(points.xyz)) < rng.uniform(1 - p.drop, 1, n)[points.owner])
    if p.occlude:
        points = points.kept(_unoccluded(points, p.occlude, rng))
    if p.outliers:
        points = _with_outliers(points, p.outliers, rng)
    low, high = _bounds(points)
    if p.scale:
        factor = rng.uniform(1 - p.scale, 1 + p.scale, (n, 3))
        points = replace(points, xyz=points.xyz * factor[points.owner])
    if p.noise:
        size = 0.5 * (high - low) * rng.uniform(0, p.noise, (n, 1))
        points = replace(points, xyz=points.xyz + rng.normal(size=points.xyz.shape) * size[points.owner])
    if p.hide_intensity:
        points = replace(points, known=points.known & (rng.random(n) >= p.hide_intensity))
    return points


def _bounds(points: Points) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    starts = points.indptr[:-1]
    return np.minimum.reduceat(points.xyz, starts), np.maximum.reduceat(points.xyz, starts)


def _unoccluded(points: Points, most: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return the points in front of a random plane that cuts off one end, for half of the objects."""
    n = len(points.indptr) - 1
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    along = (points.xyz * direction[points.owner]).sum(axis=1)
    low, high = (f.reduceat(along, points.indptr[:-1]) for f in (np.minimum, np.maximum))
    share = rng.uniform(0, most, n) * (rng.random(n) < 0.5)
    return along <= (high - share * (high - low))[points.owner]


def _with_outliers(points: Points, most: float, rng: np.random.Generator) -> Points:
    """Move some points to random positions in the bounding box."""
    low, high = _bounds(points)
    away = rng.random(len(points.xyz)) < rng.uniform(0, most, len(low))[points.owner]
    anywhere = low[points.owner] + rng.random(points.xyz.shape) * (high - low)[points.owner]
    return replace(points, xyz=np.where(away[:, None], anywhere, points.xyz))


def encode(
    points: Points, parameters: InputParameters, *, measures: NDArray[np.float32] | None = None
) -> tuple[dict[str, NDArray[np.float32]], NDArray[np.float32]]:
    """Return the images and measures of objects."""
    if parameters.clean:
        alone = isolated_points(points.xyz, points.indptr, factor=parameters.clean, least=_FEW)
        points = points.kept(~alone)
    counts = np.diff(points.indptr)
    sizes = (int(parameters.sizes[0]), int(parameters.sizes[1]), int(parameters.sizes[2]))
    window = None if parameters.window is None else (float(parameters.window[0]), float(parameters.window[1]))
    weight = 1.0 / np.repeat(counts, counts) if parameters.relative else np.ones(len(points.xyz))

    def draw(weights: NDArray[np.float64]) -> Images:
        return draw_images(
            points.xyz,
            points.indptr,
            weights,
            sizes=sizes,
            isotropic=parameters.isotropic,
            window=window,
            bilinear=parameters.bilinear,
            printed_rows=parameters.printed_rows,
        )

    shares = dict(zip(VIEWS, draw(weight), strict=True))
    value = np.where(points.known[points.owner], points.intensity, 0.0)
    brightness = dict(zip(VIEWS, draw(weight * value), strict=True)) if parameters.intensity else {}
    images = {}
    for view in parameters.views:
        share = shares[view] * np.float32(shares[view].shape[-1] ** 2 / 4) if parameters.relative else shares[view]
        channels = [np.sqrt(share) if parameters.compress else share]
        if parameters.intensity:
            channels.append(brightness[view] / np.maximum(shares[view], np.float32(1e-9)))
        images[view] = np.stack(channels, axis=2)
    if measures is not None:
        return images, measures
    measured = np.zeros((len(counts), N_MEASURES if parameters.measures else 0), dtype=np.float32)
    if parameters.measures:
        measure_objects(points.xyz, points.indptr, value, measured)
        if parameters.intensity:
            measured[:, -1] = points.known
        else:
            measured[:, -N_INTENSITY:] = 0.0
    return images, measured
