"""Buildings, fences and walls. Local x is along the street, -y faces it, the front is at y = 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.simulation.model.materials import cloth, material
from mlsroad_pipeline.simulation.model.meshes import Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import BOX_CORNERS, box, quads

_UNDERGROUND = 1.5  # depth of walls below ground, so that slopes leave no gap, metres
_SIDES = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])


def _rows(*columns: ArrayLike) -> NDArray[np.float64]:
    """Return columns, of which some may be single numbers, side by side."""
    return np.stack(np.broadcast_arrays(*columns), axis=1).astype(np.float64, copy=False)


def _boxes(surface: Surface, *groups: tuple[ArrayLike, ArrayLike]) -> Mesh:
    """Return cuboids of one surface in groups of sizes and middles, of shape (n, 3) or (3,), which broadcast."""
    pairs = [np.broadcast_arrays(np.atleast_2d(np.asarray(size, float)), np.atleast_2d(at)) for size, at in groups]
    size, centre = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    corners = centre[:, None] + BOX_CORNERS / 2 * size[:, None]
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

    def panes(self, surface: Surface) -> Mesh:
        """Return the panes of the openings."""
        return quads(_sheet(self.left, self.right, self.recess, self.low, self.high), surface)

    def frames(self, surface: Surface, *, sill: bool) -> Mesh:
        """Return mullions and rails in front of the panes, and sills below them."""
        middle, y = (self.left + self.right) / 2, self.recess - 0.02
        wide, tall = self.right - self.left, self.high - self.low
        mullion = _rows(0.06, 0.05, tall), _rows(middle, y, self.low + tall / 2)
        rail = _rows(wide, 0.05, 0.06), _rows(middle, y, self.low + 0.03)
        below = _rows(wide + 0.15, 0.14, 0.05), _rows(middle, -0.05, self.low - 0.03)
        return _boxes(surface, mullion, rail, *([below] if sill else []))

    def curtains(self, surface: Surface, rng: np.random.Generator) -> Mesh:
        """Return curtains of different lengths behind the panes."""
        edge = self.low + rng.uniform(0, 0.85, len(self.low)) * (self.high - self.low)
        return quads(_sheet(self.left, self.right, self.recess + 0.12, edge, self.high), surface)

    def shutters(self, surface: Surface) -> Mesh:
        """Return a pair of open shutters beside each opening."""
        half, tall = (self.right - self.left) / 2, self.high - self.low
        half = np.minimum(half, (self.left - self.cell[:, 0]) - 0.03)
        size, z = _rows(half, 0.04, tall), self.low + tall / 2
        left, right = _rows(self.left - half / 2, -0.03, z), _rows(self.right + half / 2, -0.03, z)
        return _boxes(surface, (size, left), (size, right))


def balconies(windows: Openings, slab: Surface, metal: Surface, depth: float) -> list[Mesh]:
    """Return balconies of a depth under windows: a slab, a hand rail and bars."""
    half = np.minimum((windows.right - windows.left) / 2 + 0.35, (windows.cell[:, 1] - windows.cell[:, 0]) / 2 - 0.05)
    x, z = (windows.left + windows.right) / 2, windows.cell[:, 2]
    floor = _boxes(slab, (_rows(2 * half, depth, 0.14), _rows(x, -depth / 2, z - 0.02)))
    rails: list[tuple[ArrayLike, ArrayLike]] = [(_rows(2 * half, 0.05, 0.05), _rows(x, -depth, z + 0.95))]
    rails += [([0.05, depth, 0.05], _rows(x + k * half, -depth / 2, z + 0.95)) for k in (-1, 1)]
    bars = [(f, -1.0) for f in np.linspace(-1, 1, 13)] + [(k, -f) for k in (-1, 1) for f in (0.25, 0.5, 0.75)]
    rails += [([0.018, 0.018, 0.95], _rows(x + f * half, k * depth, z + 0.48)) for f, k in bars]
    return [floor, _boxes(metal, *rails)]


def shop_front(rng: np.random.Generator, left: float, right: float, high: float) -> list[Mesh]:
    """Return a sign board and often an awning over a shop window, sometimes a projecting sign."""
    wide, middle = right - left, (left + right) / 2
    tall = rng.uniform(0.35, 0.65)
    board = cloth("building", rng)
    meshes = [box([wide * rng.uniform(0.8, 1.0), 0.1, tall], [middle, -0.06, high + 0.08 + tall / 2], board)]
    letters = Surface(board.label, (0.75, 0.74, 0.7), float(rng.uniform(0.4, 0.7)))
    count = int(rng.integers(4, 10))
    at = middle + np.linspace(-0.35, 0.35, count) * wide
    size = _rows(0.4 * wide / count * rng.uniform(0.5, 1.0, count), 0.03, 0.5 * tall)
    meshes.append(_boxes(letters, (size, _rows(at, -0.12, high + 0.08 + tall / 2))))
    if rng.random() < 0.55:
        out, drop = rng.uniform(0.8, 1.5), rng.uniform(0.3, 0.6)
        top, edge = high + 0.04, max(high + 0.04 - drop, 2.1)
        stripes, pale = cloth("building", rng), material("curtain", "building", rng)
        xs = np.linspace(left - 0.1, right + 0.1, int(max(wide / 0.35, 3)) // 2 * 2 + 1)
        for k, surface in enumerate((stripes, pale)):
            a, b = xs[:-1][k::2], xs[1:][k::2]
            corners = [_rows(a, 0.0, top), _rows(b, 0.0, top), _rows(b, -out, edge), _rows(a, -out, edge)]
            fringe = _sheet(a, b, -out, np.full(len(a), edge - 0.18), np.full(len(a), edge))
            meshes.append(quads(np.concatenate([np.stack(corners, axis=1), fringe]), surface))
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
    size = _rows(width + rng.uniform(0.3, 0.8), reach, level + 0.5)
    return _boxes(stone, (size, _rows(middle, -reach / 2, (level - 0.5) / 2)))


class _Plan:
    """Measures shared by all openings of one front."""

    def __init__(
        self, rng: np.random.Generator, length: float, *, shop: bool, plinth: float, storeys: tuple[int, int]
    ) -> None:
        self.length, self.plinth = length, plinth
        self.storeys = int(rng.integers(1, 5)) if rng.random() < 0.8 else 5
        if storeys[1] > 0:
            self.storeys = int(rng.integers(storeys[0], storeys[1] + 1))
        if shop:
            self.storeys = max(self.storeys, 2)
        self.storey = rng.uniform(2.7, 3.4)
        self.bays = max(int(length / rng.uniform(2.2, 3.6)), 1)
        self.width = min(rng.uniform(0.9, 1.7), length / self.bays - 0.6)
        self.sill, self.tall = rng.uniform(0.75, 0.95), rng.uniform(1.2, 1.7)
        self.recess, self.room = rng.uniform(0.06, 0.25), rng.uniform(1.5, 4.0)
        self.top = plinth + self.storeys * self.storey
        self.door = int(rng.integers(self.bays))
        self.shop = shop

    def openings(self, rng: np.random.Generator) -> tuple[Openings, Openings, Openings]:
        """Return windows, doors and shop windows."""
        level, bay = (g.ravel() for g in np.meshgrid(np.arange(self.storeys), np.arange(self.bays), indexing="ij"))
        wide = self.length / self.bays
        x0, z0 = -self.length / 2 + bay * wide, self.plinth + level * self.storey
        cell = np.stack([x0, x0 + wide, z0, z0 + self.storey], axis=1)
        ground, door = level == 0, (level == 0) & (bay == self.door)
        shop = ground & ~door & self.shop
        opened = np.where(shop, max(wide - 0.5, self.width), self.width)
        left, right = x0 + (wide - opened) / 2, x0 + (wide + opened) / 2
        sill = np.where(shop, 0.35, np.where(door, 0.02, self.sill))
        # Some windows of the upper storeys reach down to the floor.
        french = (level > 0) & (rng.random(len(level)) < 0.25)
        sill = np.where(french, 0.12, sill)
        high = np.where(shop, 2.5, np.where(door, 2.15, self.sill + self.tall))
        recess = np.where(door & (rng.random() < 0.4), rng.uniform(0.6, 1.1), self.recess)
        top = np.minimum(z0 + high, z0 + self.storey - 0.25)
        every = Openings(cell, left, right, np.asarray(z0 + sill, float), np.asarray(top, float), recess)
        return every.of(~door & ~shop), every.of(door), every.of(shop)


def building(
    rng: np.random.Generator, length: float, *, shop: bool = False, plinth: float = 0.0,
    storeys: tuple[int, int] = (0, 0),
) -> Mesh:  # fmt: skip
    """Return a building of one to five storeys, or of a number between two: windows in reveals, a door, a roof.

    Rooms lie behind the glass. The building is centred on x = 0, 7 to 12 m deep towards +y, its walls 1.5 m into the
    ground. `plinth` is the height of the ground floor, with stairs to the door.
    """
    plan = _Plan(rng, length, shop=shop, plinth=plinth, storeys=storeys)
    skin = material(str(rng.choice(["plaster", "brick", "stone", "concrete"])), "building", rng)
    windows, doors, shops = plan.openings(rng)
    glass, frame = material("glass", "building", rng), material("plaster", "building", rng)
    wood = material("wood", "building", rng)
    meshes = [windows.wall(skin), doors.wall(skin), windows.panes(glass), windows.frames(frame, sill=True)]
    meshes.append(doors.panes(wood))
    if len(shops.low):
        meshes += [shops.wall(skin), shops.panes(glass), shops.frames(frame, sill=False)]
        meshes += shop_front(rng, float(shops.left[0]), float(shops.right[-1]), float(shops.high[0]))
    draped = rng.random(len(windows.low)) < 0.45
    meshes.append(windows.of(draped).curtains(material("curtain", "building", rng), rng))
    if rng.random() < 0.25:
        meshes.append(windows.of(windows.cell[:, 2] > -1).shutters(wood))
    upper = windows.of((windows.cell[:, 2] > plinth + 1) & (rng.random(len(windows.low)) < 0.5))
    if rng.random() < 0.45 and len(upper.low):
        meshes += balconies(upper, skin, material("painted_metal", "building", rng), rng.uniform(0.7, 1.2))
    middle, wide = float(doors.left[0] + doors.right[0]) / 2, float(doors.right[0] - doors.left[0])
    meshes.append(stairs(rng, middle, wide, max(plinth, 0.12)))
    return join([*meshes, *_shell(rng, plan, skin, material("room", "building", rng))])


def _shell(rng: np.random.Generator, plan: _Plan, skin: Surface, room: Surface) -> list[Mesh]:
    """Return the walls without openings, floors, the rear wall of the rooms, a cornice and the roof."""
    h, depth = plan.length / 2, rng.uniform(7, 12)
    height = plan.top + rng.uniform(0.2, 0.6)
    base = [[-h, 0, -_UNDERGROUND], [h, 0, -_UNDERGROUND], [h, 0, plan.plinth], [-h, 0, plan.plinth]]
    parapet = [[-h, 0, plan.top], [h, 0, plan.top], [h, 0, height], [-h, 0, height]]
    ends = [[[x, 0, -_UNDERGROUND], [x, depth, -_UNDERGROUND], [x, depth, height], [x, 0, height]] for x in (-h, h)]
    back = [[-h, depth, -_UNDERGROUND], [h, depth, -_UNDERGROUND], [h, depth, height], [-h, depth, height]]
    inner = plan.recess + plan.room
    rear = [[-h, inner, 0], [h, inner, 0], [h, inner, height], [-h, inner, height]]
    levels = plan.plinth + plan.storey * np.arange(plan.storeys + 1)
    floors = [[[-h, 0.3, z], [h, 0.3, z], [h, inner, z], [-h, inner, z]] for z in levels]
    cornice = box([plan.length, 0.12, 0.15], [0, -0.05, height - 0.1], skin)
    return [quads([base, parapet, *ends, back], skin), quads([rear, *floors], room), cornice,
            *_roof(rng, plan.length, depth, height)]  # fmt: skip


def _roof(rng: np.random.Generator, length: float, depth: float, height: float) -> list[Mesh]:
    tile = material("roof_tile", "building", rng)
    h = length / 2 + 0.05
    if rng.random() < 0.35:
        return [box([length, depth, 0.2], [0, depth / 2, height + 0.1], material("concrete", "building", rng))]
    over, ridge = rng.uniform(0.15, 0.5), height + depth / 2 * rng.uniform(0.3, 0.8)
    low, middle, far = height - 0.1, depth / 2, depth + over
    slopes = [
        [[-h, -over, low], [h, -over, low], [h, middle, ridge], [-h, middle, ridge]],
        [[-h, far, low], [-h, middle, ridge], [h, middle, ridge], [h, far, low]],
    ]
    gables = [[[x, 0, height], [x, depth, height], [x, middle, ridge], [x, middle, ridge]] for x in (-h, h)]
    # A gutter along the eaves and a downpipe at the front.
    pipe = material("galvanised", "building", rng)
    gutter = [2 * h, 0.12, 0.1], [0, -over - 0.05, low]
    drain = _boxes(pipe, gutter, ([0.09, 0.09, height], [h - 0.2, -0.08, height / 2]))
    return [quads([*slopes, *gables], tile), drain]


def fence(rng: np.random.Generator, length: float) -> Mesh:
    """Return a run of fence along x, centred, 0.9 to 1.9 m high: palings, railings, or wire mesh on posts."""
    design = int(rng.integers(3))
    skin = material(["wood", "painted_metal", "galvanised"][design], "fence", rng)
    height, h = rng.uniform(0.9, 1.9), length / 2
    posts = np.linspace(-h, h, max(int(length / 2.2), 1) + 1)
    levels = (np.array([0.2, 0.8]) if design < 2 else np.arange(0.08, 1.0, 0.12 / height)) * height
    thin = (0.06, 0.06, 0.005)[design]
    step = (0.14, 0.13, 0.12)[design] * rng.uniform(0.8, 1.3)
    width, thick = ((0.09, 0.02), (0.016, 0.016), (0.005, 0.005))[design]
    xs = np.arange(-h + step, h, step)
    tall = height * (rng.uniform(0.97, 1.03, len(xs)) if design == 0 else np.ones(len(xs)))
    return _boxes(
        skin, ([0.09, 0.09, height + 0.6], _rows(posts, 0.0, (height - 0.4) / 2)),
        ([length, thin * 0.5 if design < 2 else thin, thin], _rows(0.0, 0.0, levels)),
        (_rows(width, thick, tall - 0.06), _rows(xs, -0.03, tall / 2 + 0.03)),
    )  # fmt: skip


def wall(rng: np.random.Generator, length: float) -> Mesh:
    """Return a run of garden wall along x, centred, 0.6 to 2.1 m high, with a cap and sometimes pillars or railings.

    Faces are `wall`, railings `fence`.
    """
    skin = material(str(rng.choice(["brick", "stone", "plaster", "concrete"])), "wall", rng)
    height, thick = rng.uniform(0.6, 2.1), rng.uniform(0.18, 0.34)
    meshes = [box([length, thick, height + 0.8], [0, 0, (height - 0.8) / 2], skin)]
    meshes.append(box([length, thick + 0.08, 0.06], [0, 0, height + 0.03], material("stone", "wall", rng)))
    if rng.random() < 0.5:
        size = [thick + 0.12, thick + 0.12, height + 1.0]
        meshes.append(_boxes(skin, (size, [[x, 0, (height - 0.6) / 2] for x in (-length / 2, length / 2)])))
    if height < 1.1 and rng.random() < 0.4:
        iron, tall = material("painted_metal", "fence", rng), rng.uniform(0.4, 0.8)
        xs = np.arange(-length / 2 + 0.12, length / 2, 0.13)
        meshes.append(_boxes(iron, ([0.016, 0.016, tall], _rows(xs, 0.0, height + 0.06 + tall / 2))))
        meshes.append(box([length, 0.03, 0.03], [0, 0, height + 0.03 + 0.9 * tall], iron))
    return join(meshes)
