"""Fronts of buildings, all cells at once. Local x is along the front, -y faces the street, the wall is at y = 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.simulation.model.materials import cloth, material
from mlsroad_pipeline.simulation.model.meshes import Mesh, Surface
from mlsroad_pipeline.simulation.model.solids import box, quads

_UNIT = (
    np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]]) / 2
)
_SIDES = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])


def boxes(sizes: ArrayLike, centres: ArrayLike, surface: Surface) -> Mesh:
    """Return cuboids of one surface; sizes and middles of shape (n, 3) or (3,) broadcast."""
    size, centre = np.broadcast_arrays(np.atleast_2d(np.asarray(sizes, float)), np.atleast_2d(centres))
    corners = centre[:, None] + _UNIT * size[:, None]
    return quads(corners[:, _SIDES].reshape(-1, 4, 3), surface)


def _sheet(left: NDArray, right: NDArray, y: ArrayLike, low: NDArray, high: NDArray) -> NDArray[np.float64]:
    """Return upright rectangles, one per opening, shape (n, 4, 3)."""
    depth = np.broadcast_to(np.asarray(y, dtype=np.float64), left.shape)
    x, z = np.stack([left, right, right, left], 1), np.stack([low, low, high, high], 1)
    return np.stack([x, np.repeat(depth[:, None], 4, axis=1), z], axis=2)


@dataclass(frozen=True)
class Openings:
    """Doors and windows of a front, one row each."""

    cell: NDArray[np.float64]  # Left, right, bottom and top of the part of the wall around it, metres
    # left, right, low, high: the opening itself, metres
    left: NDArray[np.float64]
    right: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    recess: NDArray[np.float64]  # Depth of its pane behind the wall, metres

    def of(self, rows: NDArray) -> Openings:
        """Return some of the openings."""
        parts = (self.cell, self.left, self.right, self.low, self.high, self.recess)
        return Openings(*(part[rows] for part in parts))

    def wall(self, skin: Surface) -> Mesh:
        """Return the wall around the openings and their reveals."""
        x0, x1, z0, z1 = self.cell.T
        zero, r = np.zeros(len(x0)), self.recess
        a, b, c, d = self.left, self.right, self.low, self.high
        fronts = [_sheet(x0, a, 0.0, z0, z1), _sheet(b, x1, 0.0, z0, z1), _sheet(a, b, 0.0, z0, c),
                  _sheet(a, b, 0.0, d, z1)]  # fmt: skip
        reveals = [
            np.stack([np.stack([x, y, z], 1) for x, y, z in corners], axis=1)
            for corners in (
                ((a, zero, c), (a, r, c), (a, r, d), (a, zero, d)),
                ((b, zero, c), (b, zero, d), (b, r, d), (b, r, c)),
                ((a, zero, c), (b, zero, c), (b, r, c), (a, r, c)),
                ((a, zero, d), (a, r, d), (b, r, d), (b, zero, d)),
            )
        ]
        return quads(np.concatenate([*fronts, *reveals]), skin)

    def panes(self, surface: Surface, *, behind: float = 0.0) -> Mesh:
        """Return the panes of the openings."""
        return quads(_sheet(self.left, self.right, self.recess + behind, self.low, self.high), surface)

    def frames(self, surface: Surface, *, sill: bool) -> Mesh:
        """Return mullions and rails in front of the panes, and sills below them."""
        middle, y = (self.left + self.right) / 2, self.recess - 0.02
        wide, tall = self.right - self.left, self.high - self.low
        n = len(middle)
        bars = [
            (np.stack([np.full(n, 0.06), np.full(n, 0.05), tall], 1), np.stack([middle, y, self.low + tall / 2], 1)),
            (np.stack([wide, np.full(n, 0.05), np.full(n, 0.06)], 1), np.stack([middle, y, self.low + 0.03], 1)),
        ]
        if sill:
            size = np.stack([wide + 0.15, np.full(n, 0.14), np.full(n, 0.05)], 1)
            bars.append((size, np.stack([middle, np.full(n, -0.05), self.low - 0.03], 1)))
        return boxes(np.concatenate([s for s, _ in bars]), np.concatenate([c for _, c in bars]), surface)

    def curtains(self, surface: Surface, rng: np.random.Generator) -> Mesh:
        """Return curtains of different lengths behind the panes."""
        edge = self.low + rng.uniform(0, 0.85, len(self.low)) * (self.high - self.low)
        return quads(_sheet(self.left, self.right, self.recess + 0.12, edge, self.high), surface)

    def shutters(self, surface: Surface) -> Mesh:
        """Return a pair of open shutters beside each opening."""
        half, tall = (self.right - self.left) / 2, self.high - self.low
        half = np.minimum(half, (self.left - self.cell[:, 0]) - 0.03)
        size = np.stack([half, np.full(len(half), 0.04), tall], 1)
        z = self.low + tall / 2
        y = np.full(len(half), -0.03)
        left, right = np.stack([self.left - half / 2, y, z], 1), np.stack([self.right + half / 2, y, z], 1)
        return boxes(np.concatenate([size, size]), np.concatenate([left, right]), surface)


def balconies(windows: Openings, slab: Surface, metal: Surface, depth: float) -> list[Mesh]:
    """Return balconies of a depth under windows: a slab, a hand rail and bars."""
    half = np.minimum((windows.right - windows.left) / 2 + 0.35, (windows.cell[:, 1] - windows.cell[:, 0]) / 2 - 0.05)
    x, z = (windows.left + windows.right) / 2, windows.cell[:, 2]
    n = len(x)

    def row(*columns: ArrayLike) -> NDArray[np.float64]:
        return np.stack([np.broadcast_to(np.asarray(c, dtype=np.float64), (n,)) for c in columns], axis=1)

    floor = boxes(row(2 * half, depth, 0.14), row(x, -depth / 2, z - 0.02), slab)
    rails = [
        (row(2 * half, 0.05, 0.05), row(x, -depth, z + 0.95)),
        (row(0.05, depth, 0.05), row(x - half, -depth / 2, z + 0.95)),
        (row(0.05, depth, 0.05), row(x + half, -depth / 2, z + 0.95)),
    ]
    rails += [(row(0.018, 0.018, 0.95), row(x + f * half, -depth, z + 0.48)) for f in np.linspace(-1, 1, 13)]
    rails += [
        (row(0.018, 0.018, 0.95), row(x + k * half, -f * depth, z + 0.48)) for k in (-1, 1) for f in (0.25, 0.5, 0.75)
    ]
    return [floor, boxes(np.concatenate([s for s, _ in rails]), np.concatenate([c for _, c in rails]), metal)]


def shop_front(rng: np.random.Generator, left: float, right: float, high: float) -> list[Mesh]:
    """Return a sign board and often an awning over a shop window, sometimes a projecting sign."""
    wide, middle = right - left, (left + right) / 2
    tall = rng.uniform(0.35, 0.65)
    board = cloth("building", rng)
    meshes = [box([wide * rng.uniform(0.8, 1.0), 0.1, tall], [middle, -0.06, high + 0.08 + tall / 2], board)]
    letters = Surface(board.label, (0.75, 0.74, 0.7), float(rng.uniform(0.4, 0.7)))
    count = int(rng.integers(4, 10))
    at = middle + np.linspace(-0.35, 0.35, count) * wide
    size = np.stack(
        [0.4 * wide / count * rng.uniform(0.5, 1.0, count), np.full(count, 0.03), np.full(count, 0.5 * tall)]
    )
    place = np.stack([at, np.full(count, -0.12), np.full(count, high + 0.08 + tall / 2)], axis=1)
    meshes.append(boxes(size.T, place, letters))
    if rng.random() < 0.55:
        out, drop = rng.uniform(0.8, 1.5), rng.uniform(0.3, 0.6)
        top, edge = high + 0.04, max(high + 0.04 - drop, 2.1)
        stripes, pale = cloth("building", rng), material("curtain", "building", rng)
        xs = np.linspace(left - 0.1, right + 0.1, int(max(wide / 0.35, 3)) // 2 * 2 + 1)
        for k, surface in enumerate((stripes, pale)):
            a, b = xs[:-1][k::2], xs[1:][k::2]
            slope = [np.stack([np.stack([x, np.full(len(x), y), np.full(len(x), z)], 1) for x, y, z in (
                (a, 0.0, top), (b, 0.0, top), (b, -out, edge), (a, -out, edge))], axis=1)]  # fmt: skip
            fringe = _sheet(a, b, -out, np.full(len(a), edge - 0.18), np.full(len(a), edge))
            meshes.append(quads(np.concatenate([*slope, fringe]), surface))
    if rng.random() < 0.3:
        x = left if rng.random() < 0.5 else right
        meshes.append(box([0.08, 0.7, 0.5], [x, -0.4, high + rng.uniform(0.5, 0.9)], cloth("building", rng)))
    return meshes


def stairs(rng: np.random.Generator, middle: float, width: float, top: float) -> Mesh:
    """Return steps up to a door towards -y, 0.5 m into the ground; every face is `stairs`."""
    stone = material("concrete", "stairs", rng)
    count = max(int(np.ceil(top / rng.uniform(0.15, 0.18))), 1)
    run = rng.uniform(0.27, 0.32)
    k = np.arange(count)
    level, reach = top - k * top / count, run * (k + 1) + 0.5
    size = np.stack([np.full(count, width + rng.uniform(0.3, 0.8)), reach, level + 0.5], axis=1)
    centre = np.stack([np.full(count, middle), -reach / 2, (level - 0.5) / 2], axis=1)
    return boxes(size, centre, stone)
