"""Inputs of the network: cleaned objects, their images and measures, and augmentation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.features.accumulation_images import Images, draw_images
from mlsroad_pipeline.papers.luo2019.jointnet.parameters import (
    N_INTENSITY,
    N_MEASURES,
    VIEWS,
    AugmentationParameters,
    InputParameters,
)

_FLOOR = 0.05
"""Offset of lengths before the logarithm, metres; smaller lengths are hardly distinguished."""

_LAYERS = 4


@njit(cache=True, nogil=True)
def measure_objects(
    xyz: NDArray[np.float64], indptr: NDArray[np.int64], value: NDArray[np.float64], out: NDArray[np.float32]
) -> None:
    """Compute the measures of objects.

    Lengths are logarithms of metres. "Along" is the horizontal direction of largest spread, "across" is perpendicular.
    """
    for k in range(len(out)):
        first, last = indptr[k], indptr[k + 1]
        n = last - first
        x, y = xyz[first:last, 0] - xyz[first, 0], xyz[first:last, 1] - xyz[first, 1]
        z = xyz[first:last, 2] - xyz[first:last, 2].min()
        x, y = x - x.mean(), y - y.mean()
        angle = 0.5 * np.arctan2(2.0 * (x * y).sum(), (x * x).sum() - (y * y).sum())
        along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        height = max(z.max(), 1e-3)
        row = out[k]
        for j, axis in enumerate((z, along, across)):
            row[j] = np.log(axis.max() - axis.min() + 2.0 * _FLOOR)
            row[3 + j] = np.log(axis.std() + _FLOOR)
            ordered = np.sort(axis)
            # Symmetric ranks, since the sign of the axis is arbitrary.
            row[9 + j] = np.log(ordered[n - 1 - (n - 1) // 20] - ordered[(n - 1) // 20] + _FLOOR)
            if j == 0:
                for i in range(3):
                    row[6 + i] = ordered[(n - 1) * (i + 1) // 4] / height
        _layers(z / height, along, across, row[12:24])
        _quantiles(np.sqrt(x * x + y * y), row[24:29])
        for i in range(24, 29):
            row[i] = np.log(row[i] + _FLOOR)
        _axes(x, y, z - z.mean(), row[29:34])
        bright = value[first:last]
        row[34], row[35] = bright.mean(), bright.std()
        _quantiles(bright, row[36:41])


@njit(cache=True, nogil=True)
def _quantiles(values: NDArray[np.float64], out: NDArray[np.float32]) -> None:
    ordered, n = np.sort(values), len(values) - 1
    for i, share in enumerate((0.1, 0.25, 0.5, 0.75, 0.9)):
        out[i] = ordered[int(n * share)]


@njit(cache=True, nogil=True)
def _layers(
    height: NDArray[np.float64], along: NDArray[np.float64], across: NDArray[np.float64], out: NDArray[np.float32]
) -> None:
    sums = np.zeros((_LAYERS, 5))
    for i in range(len(height)):
        s = sums[min(int(height[i] * _LAYERS), _LAYERS - 1)]
        s[0] += 1.0
        s[1] += along[i]
        s[2] += along[i] * along[i]
        s[3] += across[i]
        s[4] += across[i] * across[i]
    for layer in range(_LAYERS):
        s = sums[layer]
        c = max(s[0], 1.0)
        out[3 * layer] = s[0] / len(height)
        for j in range(2):
            variance = s[2 + 2 * j] / c - (s[1 + 2 * j] / c) ** 2
            out[3 * layer + 1 + j] = np.log(np.sqrt(max(variance, 0.0)) + _FLOOR)


@njit(cache=True, nogil=True)
def _axes(x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], out: NDArray[np.float32]) -> None:
    """Compute linearity, planarity and scattering from standard deviations, and the steepness of the extreme axes."""
    covariance = np.zeros((3, 3))
    parts = (x, y, z)
    for i in range(3):
        for j in range(3):
            covariance[i, j] = (parts[i] * parts[j]).mean()
        covariance[i, i] += 1e-8
    values, vectors = np.linalg.eigh(covariance)
    s = np.sqrt(np.maximum(values, 1e-9))
    out[0], out[1], out[2] = (s[2] - s[1]) / s[2], (s[1] - s[0]) / s[2], s[0] / s[2]
    out[3], out[4] = abs(vectors[2, 0]), abs(vectors[2, 2])


NEIGHBOURS = 4
"""Nearest points whose mean distance is the spacing of a point."""

PASSES = 3
"""Most passes; outliers close to each other are isolated once others have gone."""

_LEAST_SHARE = 0.5


def isolated_points(
    xyz: NDArray[np.float64], indptr: NDArray[np.int64], *, factor: float, least: int
) -> NDArray[np.bool_]:
    """Return the points of objects that are isolated."""
    alone = np.zeros(len(xyz), dtype=np.bool_)
    for first, last in zip(indptr[:-1].tolist(), indptr[1:].tolist(), strict=True):
        if last - first > least:
            alone[first:last] = _isolated(xyz[first:last], factor, least)
    return alone


def _isolated(xyz: NDArray[np.float64], factor: float, least: int) -> NDArray[np.bool_]:
    """Select isolated points; a later pass searches again only for points that have lost a neighbour."""
    keep, stale = np.ones((2, len(xyz)), dtype=np.bool_)
    spacing, near = np.zeros(len(xyz)), np.zeros((len(xyz), NEIGHBOURS), dtype=np.int64)
    for _ in range(PASSES):
        rows = np.flatnonzero(keep)
        if len(rows) <= max(least, NEIGHBOURS):
            break
        if len(new := np.flatnonzero(keep & stale)):
            tree = cKDTree(xyz[rows], compact_nodes=False, balanced_tree=False)  # faster for one search
            distance, found = tree.query(xyz[new], k=NEIGHBOURS + 1)
            spacing[new], near[new] = distance[:, 1:].mean(axis=1), rows[found[:, 1:]]
        alone = spacing[rows] > factor * np.median(spacing[rows])
        if not alone.any() or len(rows) - alone.sum() < _LEAST_SHARE * len(xyz):
            break
        keep[rows[alone]] = False
        stale = np.logical_not(keep[near].all(axis=1))
    return ~keep


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
            printed=parameters.printed_equations,
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
