"""Slow, obvious versions of the context features and label smoothing of supervoxels."""

import numpy as np
from references.forest import eigen_features


def voxel_centroids(xyz, size):
    """Average the points of each occupied voxel of a grid with a corner at the centre of the bounding box."""
    cells = np.floor((xyz - (xyz.min(axis=0) + xyz.max(axis=0)) / 2) / size).astype(int)
    _, owners = np.unique(cells, axis=0, return_inverse=True)
    owners = owners.ravel()
    return np.stack([xyz[owners == v].mean(axis=0) for v in range(owners.max() + 1)])


def ball_features(voxels, centre, radius):
    """Describe the voxels within a radius; None where there are fewer than three."""
    near = voxels[np.linalg.norm(voxels - centre, axis=1) <= radius]
    if len(near) < 3:
        return None
    found = eigen_features(near)
    plan = np.linalg.eigvalsh(np.cov(near[:, :2].T, bias=True))
    return {
        **{name: value for name, value in found.items() if np.isscalar(value)},
        "normal_z": abs(found["normal"][2]),
        "direction_z": abs(found["direction"][2]),
        "horizontal_linearity": 1 - max(plan[0], 0) / plan[1],
    }


def footprint(xyz, centre, radius, cell, relief_radius, clearance=1.0):
    """Describe the columns within a radius, cell by cell and slice by slice."""
    corner = xyz.min(axis=0)
    cells = ((xyz[:, :2] - corner[:2]) / cell).astype(int)
    slices = ((xyz[:, 2] - corner[2]) / cell).astype(int)
    reach, first = max(1, round(relief_radius / cell)), round(clearance / cell)
    place = (centre[:2] - corner[:2]) / cell - 0.5
    n_cells, weights, offsets, tops = 0, [], [], []
    for x in range(int(place[0] - radius / cell) - 2, int(place[0] + radius / cell) + 4):
        for y in range(int(place[1] - radius / cell) - 2, int(place[1] + radius / cell) + 4):
            if np.hypot(x - place[0], y - place[1]) * cell > radius:
                continue
            n_cells += 1
            inside = (cells == [x, y]).all(axis=1)
            if not inside.any():
                continue
            around = np.abs(cells - [x, y]).max(axis=1) <= reach
            base = int((xyz[around, 2].min() - corner[2]) / cell)
            levels = {level - base for level in slices[inside] if level - base >= first}
            if levels:
                weights.append(len(levels))
                offsets.append([x - place[0], y - place[1]])
                tops.append(max(levels) + 1)
    if not weights:
        return [np.nan, np.nan, 0.0, 0.0, 0.0]
    rest = [len(weights) / n_cells, np.mean(weights) * cell, max(tops) * cell]
    if len(weights) < 2:
        return [np.nan, np.nan, *rest]
    narrow, wide = np.linalg.eigvalsh(np.cov(np.array(offsets).T, aweights=weights, bias=True))
    return [1 - max(narrow, 0) / wide, np.sqrt(max(narrow, 0)) * cell, *rest]


def smoothed(probabilities, adjacency, weight):
    """Mix the probabilities of each supervoxel with the mean of its neighbours'."""
    dense = adjacency.toarray() != 0
    rows = [
        (1 - weight) * own + weight * probabilities[near].mean(axis=0) if near.any() else own
        for own, near in zip(probabilities, dense, strict=True)
    ]
    return np.array(rows)
