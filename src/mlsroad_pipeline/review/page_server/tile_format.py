"""Layout of tiles (chunks of points and their index), and the first picture."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.review.page_server.cloud_files import REFERENCE, VALUES, CloudFiles

FORMAT = 2
INDEX = "index.json"
POINT = np.dtype([("xyz", "<u2", (3,)), *VALUES.descr])
"""A point relative to its cube."""

LEVELS = 10
COARSEST, UNDIVIDED = 4, 3
"""Bits per axis of the cells of level 0 (16 cells along an edge), and the last level whose nodes are whole cubes."""


def spacing(edge: float, level: int) -> float:
    """Return the distance of the points of a level, metres."""
    return edge / (1 << (COARSEST + level))


def depth(level: int) -> int:
    """Return how often the edge of a cube is halved in the nodes of a level."""
    return max(0, level - UNDIVIDED)


def level_file(level: int) -> str:
    """Return the name of the file of a level."""
    return f"level{level}.bin"


def point_bytes(coloured: bool) -> int:
    """Return the bytes of a point in a chunk."""
    return 24 if coloured else 20


def pack(points: NDArray, *, coloured: bool) -> bytes:
    """Return a chunk of points of dtype `POINT`."""
    places = np.empty((len(points), 4), dtype="<u2")
    places[:, :3], places[:, 3] = points["xyz"], points["intensity"]
    codes = np.empty((len(points), 4), dtype="u1")
    for i, name in enumerate(("class", "confidence", "reference", "spare")):
        codes[:, i] = points[name]
    planes = [places, points["object"], points["row"], codes, *([points["rgb"]] if coloured else [])]
    return b"".join(np.ascontiguousarray(plane).tobytes() for plane in planes)


@dataclass(frozen=True)
class Chunk:
    """Decoded points of a node: steps of the cube, object, row and codes."""

    steps: NDArray[np.uint16]
    objects: NDArray[np.uint32]
    rows: NDArray[np.uint32]
    codes: NDArray[np.uint8]


def unpack(data: NDArray[np.uint8], n_points: int) -> Chunk:
    """Return the points of a chunk."""
    ends = np.cumsum([8, 4, 4, 4]) * n_points
    steps = data[: ends[0]].view("<u2").reshape(-1, 4)[:, :3]
    objects, rows = data[ends[0] : ends[1]].view("<u4"), data[ends[1] : ends[2]].view("<u4")
    return Chunk(steps, objects, rows, data[ends[2] : ends[3]].reshape(-1, 4))


@dataclass(frozen=True)
class TileIndex:
    """Index of the tiles of a survey."""

    folder: Path  # Folder of the tiles
    edge: float  # Edge of a cube, metres
    coloured: bool  # Whether chunks have colours
    # Level, cell (x, y, z in edges of a node), first point in the file of the level, number of points
    nodes: NDArray[np.int64]

    @classmethod
    def read(cls, folder: Path) -> TileIndex | None:
        """Return the index in a folder, None if there is none or it does not fit the files of the levels."""
        try:
            found: dict[str, Any] = json.loads((folder / INDEX).read_bytes())
            nodes = np.array(found["nodes"], np.int64).reshape(-1, 6)
            index = cls(folder, float(found["edge"]), bool(found["coloured"]), nodes)
            return index if found["format"] == FORMAT and index._fits() else None
        except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
            return None

    def _fits(self) -> bool:
        """Return whether each level has a file of the size that the nodes need."""
        sizes = [(self.folder / level_file(level)).stat().st_size for level in range(LEVELS)]
        levels, counts = self.nodes[:, 0], self.nodes[:, 5]
        if len(levels) and not (levels.min() >= 0 and levels.max() < LEVELS):
            return False
        points = [int(counts[levels == level].sum()) for level in range(LEVELS)]
        return sizes == [n * point_bytes(self.coloured) for n in points]

    def write(self, facts: dict[str, Any]) -> None:
        """Write the index, with more facts about the points."""
        content = {"format": FORMAT, "edge": self.edge, "coloured": self.coloured, "levels": LEVELS, **facts}
        content["coarsest"], content["undivided"] = COARSEST, UNDIVIDED
        content["nodes"] = self.nodes.tolist()
        (self.folder / INDEX).write_text(json.dumps(content, separators=(",", ":")), encoding="utf-8")

    def class_counts(self) -> dict[str, int]:
        """Return the number of points of each class code, as labelled."""
        found: dict[str, int] = json.loads((self.folder / INDEX).read_text(encoding="utf-8"))["classes"]
        return found

    def touching(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the rows of the nodes that touch a box of local coordinates."""
        width = self.edge / np.exp2(np.maximum(0, self.nodes[:, 0] - UNDIVIDED))[:, None]
        corner = self.nodes[:, 1:4] * width
        return np.flatnonzero(((corner <= high) & (corner + width >= low)).all(axis=1))

    def chunk(self, row: int) -> Chunk:
        """Return the points of a node."""
        level, _, _, _, first, count = self.nodes[row].tolist()
        size = point_bytes(self.coloured)
        data = np.fromfile(self.folder / level_file(level), np.uint8, count * size, offset=first * size)
        return unpack(data, count)

    def load(self, row: int) -> tuple[NDArray[np.float32], Chunk]:
        """Return local coordinates and points of a node."""
        chunk, (level, *cell, _, _) = self.chunk(row), self.nodes[row].tolist()
        cube = np.array(cell) >> depth(level)
        return (cube * self.edge + (chunk.steps + 0.5) * (self.edge / 65536)).astype(np.float32), chunk


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
