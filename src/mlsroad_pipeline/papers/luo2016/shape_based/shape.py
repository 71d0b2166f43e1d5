"""Features of objects: shape, context and appearance of their sites (Golovinskiy et al. 2009, section 6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

SPIN_RADII = (0.0, 0.25, 0.5, 1.0, 2.0, np.inf)
SPIN_HEIGHTS = (-np.inf, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0, np.inf)
"""Edges of the spin image's bins, metres: from the vertical axis through the object's mean, and above the ground."""
CONTEXT_RADII = (2.0, 5.0, 15.0)
"""Distances in plan within which other objects and their sites are counted, metres."""


def _grouped_means(values: NDArray[np.float64], owner: NDArray[np.int32], sizes: NDArray[np.float64]) -> NDArray:
    """Return the means of columns per object."""
    sums = np.empty((len(sizes), values.shape[1]))
    for k in range(values.shape[1]):
        sums[:, k] = np.bincount(owner, values[:, k], len(sizes))
    return sums / sizes[:, None]


def _shape(sites: NDArray[np.float64], owner: NDArray[np.int32], sizes: NDArray[np.float64]) -> list[NDArray]:
    """Return extents along the horizontal axes, standard deviations, shape features and slopes of each object."""
    means = _grouped_means(sites, owner, sizes)
    offset = sites - means[owner]
    products = (offset[:, :, None] * offset[:, None, :]).reshape(-1, 9)
    covariance = _grouped_means(products, owner, sizes).reshape(-1, 3, 3)
    values, axes = np.linalg.eigh(covariance)
    spread = np.sqrt(np.maximum(values, 0.0))
    largest = np.maximum(spread[:, 2], 1e-9)
    _, plan_axes = np.linalg.eigh(covariance[:, :2, :2])
    along = np.einsum("nk,nkj->nj", offset[:, :2], plan_axes[owner])
    extents = []
    for j in (1, 0):
        low, high = np.full(len(sizes), np.inf), np.full(len(sizes), -np.inf)
        np.minimum.at(low, owner, along[:, j])
        np.maximum.at(high, owner, along[:, j])
        extents.append(high - low)
    shares = [(spread[:, 2] - spread[:, 1]) / largest, (spread[:, 1] - spread[:, 0]) / largest, spread[:, 0] / largest]
    return [*extents, *spread.T, *shares, np.abs(axes[:, 2, 2]), np.abs(axes[:, 2, 0])]


def _heights(height: NDArray[np.float64], owner: NDArray[np.int32], sizes: NDArray[np.float64]) -> list[NDArray]:
    """Return minimum, mean, maximum, range and standard deviation of the heights of each object."""
    mean = np.bincount(owner, height, len(sizes)) / sizes
    spread = np.sqrt(np.bincount(owner, (height - mean[owner]) ** 2, len(sizes)) / sizes)
    low, high = np.full(len(sizes), np.inf), np.full(len(sizes), -np.inf)
    np.minimum.at(low, owner, height)
    np.maximum.at(high, owner, height)
    return [low, mean, high, high - low, spread]


def _spin_images(
    sites: NDArray[np.float64], height: NDArray[np.float64], owner: NDArray[np.int32], sizes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the share of each object's sites per ring around its axis and per height (Johnson and Hebert 1999)."""
    means = _grouped_means(sites[:, :2], owner, sizes)
    ring = np.searchsorted(SPIN_RADII[1:-1], np.linalg.norm(sites[:, :2] - means[owner], axis=1), side="right")
    level = np.searchsorted(SPIN_HEIGHTS[1:-1], height, side="right")
    n_bins = (len(SPIN_RADII) - 1) * (len(SPIN_HEIGHTS) - 1)
    cells = owner.astype(np.int64) * n_bins + ring * (len(SPIN_HEIGHTS) - 1) + level
    return np.bincount(cells, minlength=len(sizes) * n_bins).reshape(-1, n_bins) / sizes[:, None]


def _context(sites: NDArray[np.float64], owner: NDArray[np.int32], sizes: NDArray[np.float64]) -> list[NDArray]:
    """Count the other objects and the other sites around each object in plan."""
    means = _grouped_means(sites[:, :2], owner, sizes)
    objects, everything = cKDTree(means), cKDTree(sites[:, :2])
    columns = []
    for radius in CONTEXT_RADII:
        inside = np.linalg.norm(sites[:, :2] - means[owner], axis=1) <= radius
        own = np.bincount(owner[inside], minlength=len(sizes))
        columns.append(objects.query_ball_point(means, radius, return_length=True) - 1.0)
        columns.append(np.log1p(everything.query_ball_point(means, radius, return_length=True) - own))
    return columns


def describe_objects(
    sites: NDArray[np.float64], height: NDArray[np.floating], appearance: NDArray[np.floating], owner: NDArray[np.int32]
) -> NDArray[np.float32]:
    """Return the features of each object."""
    if len(sites) == 0:
        return np.zeros((0, 1), np.float32)
    sizes = np.bincount(owner).astype(np.float64)
    place = sites - sites.mean(axis=0)
    levels = height.astype(np.float64)
    columns = [np.log(sizes), *_shape(place, owner, sizes), *_heights(levels, owner, sizes)]
    columns += [*_spin_images(place, levels, owner, sizes).T, *_context(place, owner, sizes)]
    columns += [*_grouped_means(appearance.astype(np.float64), owner, sizes).T]
    return np.stack(columns, axis=1).astype(np.float32)
