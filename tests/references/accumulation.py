"""Reference implementation of accumulation images, point by point."""

import numpy as np


def normalised(points, isotropic=False, window=None):
    """Return points scaled to [-1, 1] x [-1, 1] x [0, 2]."""
    points = np.asarray(points, dtype=np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    if window is not None:
        half_width, height = window
        plan = (points[:, :2] - (low[:2] + high[:2]) / 2) / half_width
        up = 2 * (points[:, 2] - low[2]) / height
        return np.column_stack([np.clip(plan, -1, 1), np.clip(up, 0, 2)])
    extent = np.full(3, (high - low).max()) if isotropic else high - low
    unit = np.zeros_like(points)
    for axis in range(3):
        if extent[axis] > 0:
            unit[:, axis] = 2 * (points[:, axis] - (low[axis] + high[axis]) / 2) / extent[axis]
    return unit + [0, 0, 1]


def images(points, sizes, isotropic=False, window=None, relative=True, bilinear=False, printed=False):
    """Return HSSI, VQAI and VAAI of the whole and of the slices as lists of arrays."""
    unit = normalised(points, isotropic, window)
    parts = [(unit, np.ones(len(unit), bool))]
    for s in range(4):
        inside = np.clip(np.floor(unit[:, 2] / 0.5), 0, 3) == s
        stretched = unit.copy()
        stretched[:, 2] = (unit[:, 2] - 0.5 * s) / 0.5 * 2
        parts.append((stretched, inside))
    found = ([], [], [])
    for part, inside in parts:
        drawn = [np.zeros((size, size)) for size in sizes]
        for x, y, z in part[inside]:

            def shares(value, size):
                place = value / (2 / size)
                if bilinear:  # of each cell by the distance of its centre, all within the outermost centres
                    place = np.clip(place, 0.5, size - 0.5)
                    return np.maximum(0, 1 - np.abs(np.arange(size) + 0.5 - place))
                return np.arange(size) == min(np.floor(place), size - 1)

            row = (z + 2) / 2 if printed else z  # equation 4 as printed: floor((beta + 2) / (2 k1)), beta = z
            drawn[0] += np.outer(shares(row, sizes[0]), shares(np.hypot(x, y), sizes[0]))
            drawn[1] += np.outer(shares(x + 1, sizes[1]), shares(y + 1, sizes[1]))
            to_point = np.array([x, y, z + 1])
            cosine = to_point[2] / np.linalg.norm(to_point)
            cosine /= np.linalg.norm(to_point) if printed else 1  # equation 7 as printed has no square root
            stretch = sizes[2] if printed else 1  # equation 8 as printed: cells of 2 / N, N = R^2
            drawn[2] += cosine * np.outer(shares(stretch * (x + 1), sizes[2]), shares(stretch * (y + 1), sizes[2]))
        for kind, image in zip(found, drawn, strict=True):
            kind.append(image / len(unit) if relative else image)
    return [np.stack(kind) for kind in found]
