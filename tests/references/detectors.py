"""Slow, obvious implementations of the kernels of the baseline detectors."""

from __future__ import annotations

import numpy as np


def spin_image(points, query, normal, radius, n_radial, n_axial):
    """Spin image of one oriented point, with bilinear weights of each neighbour."""
    reach = radius / np.sqrt(2.0)
    alphas, betas = np.linspace(0, reach, n_radial), np.linspace(-reach, reach, n_axial)
    image = np.zeros((n_radial, n_axial))
    for point in points:
        away = point - query
        distance = np.linalg.norm(away)
        beta = away @ normal
        alpha = np.linalg.norm(away - beta * normal)
        if distance == 0 or distance > radius or alpha > reach or abs(beta) > reach:
            continue
        rows = np.maximum(0, 1 - np.abs(alphas - alpha) / (alphas[1] - alphas[0]))
        columns = np.maximum(0, 1 - np.abs(betas - beta) / (betas[1] - betas[0]))
        image += np.outer(rows, columns)
    return image.ravel() / image.sum() if image.sum() else image.ravel()


def similarity_of_turn(image, reference, turn):
    """Normalised correlation of two Gaussian images after rotating the reference by whole cells."""
    turned = np.roll(reference, turn, axis=1)
    return (image * turned).sum() / np.sqrt((image**2).sum() * (reference**2).sum())


def peak_of_circles(centres, radii, rises, weights, cell, height_cell, n_directions):
    """Highest value of the vote space of one object with one offset per part, blurred by (1, 2, 1) / 4 along each axis."""
    low = centres.min(axis=0)
    sizes, margins = np.array([cell, cell, height_cell]), np.array([2, 2, 1])
    corner = low - (margins + 0.5) * sizes
    shape = ((centres.max(axis=0) - low) / sizes).astype(int) + 2 * margins + 2
    space = np.zeros(shape)
    for centre, radius, rise, weight in zip(centres, radii, rises, weights, strict=True):
        n = 1
        while n < n_directions and n < 2 * np.pi * radius / cell:
            n *= 2
        for angle in np.arange(n) * 2 * np.pi / n:
            place = centre + [radius * np.cos(angle), radius * np.sin(angle), rise]
            index = np.floor((place - corner) / sizes).astype(int)
            if (index >= 0).all() and (index < shape).all():
                space[tuple(index)] += weight / n
    for axis in range(3):
        padded = np.pad(space, [(1, 1) if a == axis else (0, 0) for a in range(3)])
        before, after = (np.take(padded, np.arange(space.shape[axis]) + k, axis=axis) for k in (0, 2))
        space = 0.25 * before + 0.5 * space + 0.25 * after
    return space.max()


def best_cut(values, threshold_of, impurity):
    """Return the smallest impurity over all thresholds halfway between two of the values."""
    cuts = [0.5 * (a + b) for a in values for b in values if a != b]
    return min(impurity(threshold_of(cut)) for cut in cuts)
