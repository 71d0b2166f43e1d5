"""Sample of the points for the first picture, before the tiles are built, and the ranges of its values."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.review.page_server.cloud_files import REFERENCE, CloudFiles
from mlsroad_pipeline.review.page_server.tile_format import POINT, pack

SIZE = 150_000
"""Points of the first picture."""


class FirstPicture(NamedTuple):
    """Chunk of a sample, and what the page needs to draw it: JSON values."""

    chunk: bytes
    facts: dict[str, Any]


def has_colours(clouds: CloudFiles) -> bool:
    """Return whether all files have colours."""
    return "red" in clouds.dimensions


def first_picture(clouds: CloudFiles, *, size: int = SIZE) -> FirstPicture:
    """Return a sample of the points of a survey as one chunk, whose coordinates are steps of a common cube."""
    blocks = list(clouds.sample(size))
    return picture_of(
        clouds, np.concatenate([block.xyz for block in blocks]), np.concatenate([block.values for block in blocks])
    )


def picture_of(clouds: CloudFiles, xyz: NDArray[np.float64], values: NDArray) -> FirstPicture:
    """Return points as one chunk, in random order: the client draws the first ones alone where it is slow."""
    shuffled = np.random.default_rng(0).permutation(len(xyz))
    xyz, values = xyz[shuffled], values[shuffled]
    low = xyz.min(axis=0) if len(xyz) else np.zeros(3)
    edge = max(float((xyz.max(axis=0) - low).max()), 1.0) * (1 + 1e-6) if len(xyz) else 1.0
    points = np.empty(len(xyz), dtype=POINT)
    points["xyz"] = np.minimum((xyz - low) * (65536 / edge), 65535)
    for name in values.dtype.names or ():
        points[name] = values[name]
    coloured = has_colours(clouds)
    facts = {
        "n_points": len(points),
        "low": low.tolist(),
        "edge": edge,
        "coloured": coloured,
        "has_reference": REFERENCE in clouds.dimensions,
        "bounds": _bounds(xyz),
        "intensity": _range(values["intensity"]),
        "height": _range(xyz[:, 2]),
        "classes": {str(code): int(n) for code, n in enumerate(np.bincount(values["class"], minlength=256)) if n},
    }
    return FirstPicture(pack(points, coloured=coloured), facts)


def _bounds(xyz: NDArray[np.float64]) -> list[list[float]]:
    if not len(xyz):
        return [[0.0] * 3, [1.0] * 3]
    return [xyz.min(axis=0).tolist(), xyz.max(axis=0).tolist()]


def _range(values: NDArray) -> list[float]:
    """Return the values that 2 % and 98 % of the points do not exceed."""
    return np.percentile(values, [2, 98]).tolist() if len(values) else [0.0, 1.0]
