"""The same street sampled anew with each seed, as two passes of a van see it."""

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import WriteOptions
from mlsroad_pipeline.formats.las.format import LasFormat

ORIGIN = np.array([480_000.0, 5_455_000.0, 100.0])


def rectangle(corner, along, up, spacing: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return random points of a rectangle with 5 mm noise."""
    corner, along, up = (np.array(v, dtype=float) for v in (corner, along, up))
    n = int(np.linalg.norm(along) * np.linalg.norm(up) / spacing**2)
    u, v = rng.random((2, n, 1))
    return corner + u * along + v * up + rng.normal(0, 0.005, (n, 3))


def street(seed: int, *, walls: bool = True, fronts: bool = True, posts: bool = True) -> NDArray[np.float64]:
    """Return a road of 60 m with walls along it, fronts across it and posts; the same surfaces with each seed."""
    rng = np.random.default_rng(seed)
    parts = [rectangle((0, -10, 0), (60, 0, 1.2), (0, 20, 0), 0.12, rng)]
    if walls:
        parts += [rectangle((0, y, 0), (60, 0, 1.2), (0, 0, 6), 0.12, rng) for y in (-10, 10)]
    if fronts:
        parts += [rectangle((x, 6, 0), (0, 4, 0), (0, 0, 3), 0.1, rng) for x in (5, 17, 31, 44, 52)]
    if posts:
        for x, y in ((8, -5), (21, 5.2), (33, -5.1), (47, 5), (55, -5)):
            turn, high = rng.random(900) * 2 * np.pi, rng.random(900) * 5
            ring = np.column_stack([x + 0.08 * np.cos(turn), y + 0.08 * np.sin(turn), 0.02 * x + high])
            seen = np.sign(-y) * np.sin(turn) > -0.3 if seed % 2 else np.cos(turn) > -0.3
            parts.append((ring + rng.normal(0, 0.005, ring.shape))[seen])
    return np.concatenate(parts)


def write_pass(path, xyz: NDArray[np.float64], start: float) -> None:
    """Write points to LAZ, with times from `start` on along the street."""
    order = np.argsort(xyz[:, 0])
    time = start + xyz[order, 0] / 5
    path.parent.mkdir(parents=True, exist_ok=True)
    LasFormat().write(path, PointCloud(np.round(xyz[order], 3), {"gps_time": time}, ORIGIN), WriteOptions(like="none"))
