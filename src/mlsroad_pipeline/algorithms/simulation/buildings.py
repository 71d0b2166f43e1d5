"""Facades and what stands on property lines. Local x is along the street, -y faces it, the facade is at y = 0."""

from __future__ import annotations

import numpy as np

from mlsroad_pipeline.algorithms.simulation.materials import cloth, material
from mlsroad_pipeline.algorithms.simulation.meshes import Mesh, Surface, box, join, quads, tube

_UNDERGROUND = 1.5  # walls go this deep, so that slopes leave no gap


def building(rng: np.random.Generator, length: float) -> Mesh:
    """Return a building of one to five storeys: windows in reveals, rooms behind the glass, balconies, a roof.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its design, measures and colours.
    length : float
        Length of the facade along x, metres.

    Returns
    -------
    Mesh
        Centred on x = 0, 7 to 12 m deep towards +y, walls 1.5 m into the ground; every face is `building`.
    """
    storeys = int(rng.integers(1, 5)) if rng.random() < 0.8 else 5
    storey = rng.uniform(2.7, 3.4)
    depth, height = rng.uniform(7, 12), storeys * storey + rng.uniform(0.2, 0.6)
    skin = material(str(rng.choice(["plaster", "brick", "stone", "concrete"])), "building", rng)
    bays = max(int(length / rng.uniform(2.2, 3.6)), 1)
    plan = _FacadePlan(rng, skin, length / bays, storey)
    door = int(rng.integers(bays))
    meshes = []
    for level in range(storeys):
        for bay in range(bays):
            corner = (-length / 2 + bay * plan.bay, level * storey)
            meshes += plan.door(corner) if level == 0 and bay == door else plan.window(corner, level, rng)
    top = storeys * storey
    h = length / 2
    meshes.append(quads([[-h, 0, top], [h, 0, top], [h, 0, height], [-h, 0, height]], skin))
    meshes.append(quads([[-h, 0, -_UNDERGROUND], [h, 0, -_UNDERGROUND], [h, 0, 0], [-h, 0, 0]], skin))
    ends = [[[x, 0, -_UNDERGROUND], [x, depth, -_UNDERGROUND], [x, depth, height], [x, 0, height]] for x in (-h, h)]
    back = [[-h, depth, -_UNDERGROUND], [h, depth, -_UNDERGROUND], [h, depth, height], [-h, depth, height]]
    meshes.append(quads([*ends, back], skin))
    room = material("room", "building", rng)
    inner = plan.recess + plan.room
    meshes.append(quads([[-h, inner, 0], [h, inner, 0], [h, inner, height], [-h, inner, height]], room))
    floors = [[[-h, 0.3, z], [h, 0.3, z], [h, inner, z], [-h, inner, z]] for z in storey * np.arange(storeys + 1)]
    meshes.append(quads(floors, room))
    meshes.append(box([length, 0.12, 0.15], [0, -0.05, height - 0.1], skin))
    return join([*meshes, *_roof(rng, length, depth, height)])


class _FacadePlan:
    """The measures that all openings of one facade share."""

    def __init__(self, rng: np.random.Generator, skin: Surface, bay: float, storey: float) -> None:
        self.skin, self.bay, self.storey = skin, bay, storey
        self.width = min(rng.uniform(0.9, 1.7), bay - 0.6)
        self.high = rng.uniform(1.2, 1.7)
        self.sill = rng.uniform(0.75, 0.95)
        self.recess = rng.uniform(0.06, 0.25)
        self.room = rng.uniform(1.5, 4.0)
        self.glass, self.frame = material("glass", "building", rng), material("plaster", "building", rng)
        self.curtain, self.wood = material("curtain", "building", rng), material("wood", "building", rng)
        self.metal = material("painted_metal", "building", rng)
        self.balconies = rng.random() < 0.4

    def opening(
        self, corner: tuple[float, float], low: float, high: float
    ) -> tuple[list[Mesh], tuple[float, float, float, float]]:
        """Return the wall around an opening with its reveals, and the opening's left, right, bottom and top."""
        x0, z0 = corner
        x1, z1 = x0 + self.bay, z0 + self.storey
        left, right = x0 + (self.bay - self.width) / 2, x1 - (self.bay - self.width) / 2
        bottom, top = z0 + low, min(z0 + high, z1 - 0.25)
        r = self.recess
        wall = [
            [[x0, 0, z0], [left, 0, z0], [left, 0, z1], [x0, 0, z1]],
            [[right, 0, z0], [x1, 0, z0], [x1, 0, z1], [right, 0, z1]],
            [[left, 0, z0], [right, 0, z0], [right, 0, bottom], [left, 0, bottom]],
            [[left, 0, top], [right, 0, top], [right, 0, z1], [left, 0, z1]],
            [[left, 0, bottom], [left, r, bottom], [left, r, top], [left, 0, top]],
            [[right, 0, bottom], [right, 0, top], [right, r, top], [right, r, bottom]],
            [[left, 0, bottom], [right, 0, bottom], [right, r, bottom], [left, r, bottom]],
            [[left, 0, top], [left, r, top], [right, r, top], [right, 0, top]],
        ]
        return [quads(wall, self.skin)], (left, right, bottom, top)

    def window(self, corner: tuple[float, float], level: int, rng: np.random.Generator) -> list[Mesh]:
        """Return one cell with a window; some have curtains, a shutter or a balcony."""
        meshes, (left, right, low, top) = self.opening(corner, self.sill, self.sill + self.high)
        r, middle = self.recess, (left + right) / 2
        meshes.append(quads([[left, r, low], [right, r, low], [right, r, top], [left, r, top]], self.glass))
        meshes.append(box([0.06, 0.05, top - low], [middle, r - 0.02, (low + top) / 2], self.frame))
        meshes.append(box([right - left, 0.05, 0.06], [middle, r - 0.02, low + 0.03], self.frame))
        meshes.append(box([right - left + 0.15, 0.14, 0.05], [middle, -0.05, low - 0.03], self.frame))
        if rng.random() < 0.45:
            edge = rng.uniform(low, top - 0.2)
            drape = [[left, r + 0.12, edge], [right, r + 0.12, edge], [right, r + 0.12, top], [left, r + 0.12, top]]
            meshes.append(quads(drape, self.curtain))
        if self.balconies and level > 0 and rng.random() < 0.5:
            meshes += self._balcony(middle, corner[1])
        return meshes

    def door(self, corner: tuple[float, float]) -> list[Mesh]:
        """Return one cell with a door and its step."""
        meshes, (left, right, low, top) = self.opening(corner, 0.02, 2.2)
        r, middle = self.recess, (left + right) / 2
        meshes.append(quads([[left, r, low], [right, r, low], [right, r, top], [left, r, top]], self.wood))
        meshes.append(box([right - left + 0.3, 0.4, 0.3], [middle, -0.15, -0.02], self.frame))
        return meshes

    def _balcony(self, x: float, z: float) -> list[Mesh]:
        half, out = self.width / 2 + 0.35, 0.9
        meshes = [box([2 * half, out, 0.14], [x, -out / 2, z - 0.02], self.skin)]
        rail = [
            [x - half, 0, z + 0.95],
            [x - half, -out, z + 0.95],
            [x + half, -out, z + 0.95],
            [x + half, 0, z + 0.95],
        ]
        meshes.append(tube(rail, 0.025, self.metal, sides=5))
        for px in np.arange(x - half, x + half + 0.01, 0.16):
            meshes.append(box([0.018, 0.018, 0.95], [px, -out, z + 0.48], self.metal))
        return meshes


def _roof(rng: np.random.Generator, length: float, depth: float, height: float) -> list[Mesh]:
    tile = material("roof_tile", "building", rng)
    h = length / 2 + 0.05
    if rng.random() < 0.35:
        return [box([length, depth, 0.2], [0, depth / 2, height + 0.1], material("concrete", "building", rng))]
    over, ridge = rng.uniform(0.15, 0.5), height + depth / 2 * rng.uniform(0.3, 0.8)
    slopes = [
        [[-h, -over, height - 0.1], [h, -over, height - 0.1], [h, depth / 2, ridge], [-h, depth / 2, ridge]],
        [
            [-h, depth + over, height - 0.1],
            [-h, depth / 2, ridge],
            [h, depth / 2, ridge],
            [h, depth + over, height - 0.1],
        ],
    ]
    gables = [[[x, 0, height], [x, depth, height], [x, depth / 2, ridge], [x, depth / 2, ridge]] for x in (-h, h)]
    return [quads([*slopes, *gables], tile)]


def fence(rng: np.random.Generator, length: float) -> Mesh:
    """Return a run of fence along x, centred: palings, railings or wire mesh on posts.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its design, measures and colour.
    length : float
        Length of the run, metres.

    Returns
    -------
    Mesh
        0.9 to 1.9 m high; every face is `fence`.
    """
    design = int(rng.integers(3))
    skin = material(["wood", "painted_metal", "galvanised"][design], "fence", rng)
    height, h = rng.uniform(0.9, 1.9), length / 2
    count = max(int(length / 2.2), 1) + 1
    meshes = [box([0.09, 0.09, height + 0.6], [x, 0, (height - 0.4) / 2], skin) for x in np.linspace(-h, h, count)]
    levels = (0.2, 0.8) if design < 2 else np.arange(0.08, 1.0, 0.12 / height * 1.0)
    thin = 0.06 if design < 2 else 0.005
    meshes += [box([length, thin * 0.5 if design < 2 else thin, thin], [0, 0, f * height], skin) for f in levels]
    step = (0.14, 0.13, 0.12)[design] * rng.uniform(0.8, 1.3)
    width, thick = ((0.09, 0.02), (0.016, 0.016), (0.005, 0.005))[design]
    for x in np.arange(-h + step, h, step):
        tall = height * (rng.uniform(0.97, 1.03) if design == 0 else 1.0)
        meshes.append(box([width, thick, tall - 0.06], [x, -0.03, tall / 2 + 0.03], skin))
    return join(meshes)


def wall(rng: np.random.Generator, length: float) -> Mesh:
    """Return a run of garden wall along x, centred, with a cap and sometimes pillars.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its material, measures and pillars.
    length : float
        Length of the run, metres.

    Returns
    -------
    Mesh
        0.6 to 2.1 m high, caps and pillars on top; every face is `wall`.
    """
    skin = material(str(rng.choice(["brick", "stone", "plaster", "concrete"])), "wall", rng)
    height, thick = rng.uniform(0.6, 2.1), rng.uniform(0.18, 0.34)
    meshes = [box([length, thick, height + 0.8], [0, 0, (height - 0.8) / 2], skin)]
    meshes.append(box([length, thick + 0.08, 0.06], [0, 0, height + 0.03], material("stone", "wall", rng)))
    if rng.random() < 0.5:
        for x in (-length / 2, length / 2):
            meshes.append(box([thick + 0.12, thick + 0.12, height + 1.0], [x, 0, (height - 0.6) / 2], skin))
    return join(meshes)


def shop_sign(rng: np.random.Generator, width: float) -> Mesh:
    """Return a sign board over a shop front.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its height, place and colour.
    width : float
        Length of the board along x, metres.

    Returns
    -------
    Mesh
        A board 2.5 to 2.9 m above the ground, in front of the facade; it is part of the `building`.
    """
    return box([width, 0.12, rng.uniform(0.4, 0.7)], [0, -0.1, rng.uniform(2.5, 2.9)], cloth("building", rng))
