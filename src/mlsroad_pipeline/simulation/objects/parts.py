"""Parts of built objects: skins, bodies of revolution, plates that face +x; masts, arms and luminaires of poles."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.materials import material
from mlsroad_pipeline.simulation.model.meshes import DIFFUSE, Mesh, Surface, join, rotation_matrix
from mlsroad_pipeline.simulation.model.solids import box, ellipsoid, fan_faces, plate, tube

UNDERGROUND = 0.3  # Depth of masts and feet below the ground, so that a sloping street leaves no gap, metres
_SLIVER = 1e-9  # faces below this area are dropped, square metres


@cache
def _cells(rows: int, columns: int) -> NDArray[np.int64]:
    """Return the two triangles of each cell of a grid of vertices, shape (rows, columns, 2, 3)."""
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a = i * (columns + 1) + j
    b, c, d = a + 1, a + columns + 2, a + columns + 1
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2)
    faces.setflags(write=False)
    return faces


def grid_skin(points: ArrayLike, surfaces: Sequence[Surface], which: ArrayLike = 0) -> Mesh:
    """Return the skin over a grid of points of shape (k, m, 3), metres; cells without area are dropped.

    `which`, broadcast to (k - 1, m - 1), has the surface of each cell, -1 for a hole. A cell's front is where its
    corners (i, j), (i, j + 1), (i + 1, j + 1) run counter-clockwise.
    """
    grid = np.asarray(points, dtype=np.float64)
    k, m = grid.shape[:2]
    chosen = np.broadcast_to(np.asarray(which, dtype=np.int64), (k - 1, m - 1))
    kept = chosen >= 0
    faces = _cells(k - 1, m - 1)[kept].reshape(-1, 3)
    table = np.concatenate([s.rows(1) for s in surfaces])
    vertices = grid.reshape(-1, 3)
    mesh = Mesh(vertices, faces, np.repeat(table[chosen[kept]], 2, axis=0))
    return without_slivers(mesh)


def without_slivers(mesh: Mesh) -> Mesh:
    """Return the mesh without faces of no area."""
    corners = mesh.vertices[mesh.faces]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    cross = (a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]) ** 2
    cross += (a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]) ** 2 + (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) ** 2
    kept = cross > (2 * _SLIVER) ** 2
    if kept.all():
        return mesh
    return Mesh(mesh.vertices, mesh.faces[kept], mesh.attributes[kept])


def lathe(profile: ArrayLike, surface: Surface, *, at: ArrayLike = (0.0, 0.0, 0.0), sides: int = 10) -> Mesh:
    """Return a body of revolution about an upright axis through `at`.

    `profile` has radius and height of its outline, from the lowest up, (k, 2) metres; it is open at an end with a
    radius above 0.
    """
    r, z = np.asarray(profile, dtype=np.float64).T
    angle = np.arange(sides + 1) * (2 * np.pi / sides)
    angle[-1] = 0.0
    x, y = r[:, None] * np.cos(angle), r[:, None] * np.sin(angle)
    points = np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], axis=2)
    return grid_skin(points + np.asarray(at, dtype=np.float64), [surface])


def loft(sections: ArrayLike, surface: Surface, *, closed: bool = True) -> Mesh:
    """Return the skin over a sequence of convex cross-sections of shape (k, m, 3), by default closed at both ends."""
    rings = np.asarray(sections, dtype=np.float64)
    skin = grid_skin(np.concatenate([rings, rings[:, :1]], axis=1), [surface])
    if not closed:
        return skin
    return join([skin, fan(rings[0, ::-1], surface), fan(rings[-1], surface)])


def fan(corners: ArrayLike, surface: Surface) -> Mesh:
    """Return a convex polygon as triangles about its first corner; corners run counter-clockwise from its front."""
    points = np.asarray(corners, dtype=np.float64)
    return without_slivers(Mesh(points, fan_faces(len(points)), surface.rows(len(points) - 2)))


def prism(outline: ArrayLike, width: float, surface: Surface, *, at: float = 0.0) -> Mesh:
    """Return a closed prism: a convex outline of the xz plane, `width` thick along y about y = `at`."""
    flat = np.asarray(outline, dtype=np.float64)
    sections = np.empty((2, len(flat), 3))
    sections[:, :, [0, 2]] = flat
    sections[:, :, 1] = np.array([[at + width / 2], [at - width / 2]])
    return loft(sections, surface)


def rounded(width: float, height: float, radius: float) -> NDArray[np.float64]:
    """Return the 12 corners of a rectangle with rounded corners about the origin, counter-clockwise."""
    turn = np.array([0.0, np.pi / 4, np.pi / 2])
    corners = []
    for k, (sx, sy) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)]):
        middle = [sx * (width / 2 - radius), sy * (height / 2 - radius)]
        angle = turn + k * np.pi / 2
        corners.append(np.array(middle) + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    return np.concatenate(corners)


def panel(outline: ArrayLike, front: Surface, back: Surface, at: ArrayLike, *, yaw: float = 0.0) -> Mesh:
    """Return an upright convex plate, its middle at `at`, facing `yaw` radians counter-clockwise from +x.

    `outline` runs counter-clockwise about the middle, to the right and up as seen from its front.
    """
    return plate(outline, front, back).moved(at, yaw=yaw + np.pi / 2)


def rectangle(width: float, height: float) -> NDArray[np.float64]:
    """Return the corners of a rectangle about the origin, counter-clockwise."""
    return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array([width / 2, height / 2])


def leaned(mesh: Mesh, rng: np.random.Generator, *, share: float = 0.25, limit: float = 3.0) -> Mesh:
    """Return the mesh tilted about its foot: a `share` by 0.5 degrees to `limit`, the others mostly by less."""
    strong, direction = rng.random() < share, rng.uniform(0, 2 * np.pi)
    angle = np.radians(rng.uniform(0.5, limit) if strong else min(abs(rng.normal(0, 0.2)), limit))
    # Rotation about a horizontal axis.
    turn = rotation_matrix(direction, 0, 0) @ rotation_matrix(0, angle, 0) @ rotation_matrix(-direction, 0, 0)
    return Mesh(mesh.vertices @ turn.T, mesh.faces, mesh.attributes)


def tinted(
    rgb: tuple[float, float, float], label: str, reflectivity: float, rng: np.random.Generator, *, spread: float = 0.15,
    kind: int = DIFFUSE,
) -> Surface:  # fmt: skip
    """Return a surface near a colour (linear albedo) that the table of materials lacks.

    `spread` is the standard deviation of the logarithm of tone and reflectivity; that of the hue is a third of it.
    """
    tone, infrared = np.exp(rng.normal(0, spread, 2))
    r, g, b = (float(c) for c in np.clip(np.array(rgb) * tone * np.exp(rng.normal(0, spread / 3, 3)), 0.005, 0.95))
    return Surface(TAXONOMY[label], (r, g, b), float(np.clip(reflectivity * infrared, 0.02, 0.95)), kind)


def metal(label: str, rng: np.random.Generator) -> Surface:
    """Return the surface of a mast: galvanised, painted, or weathered aluminium."""
    return material(str(rng.choice(["galvanised", "painted_metal", "aluminium"], p=[0.45, 0.4, 0.15])), label, rng)


def mast(rng: np.random.Generator, height: float, radius: float, surface: Surface) -> Mesh:
    """Return an upright mast, from below ground, with a foot: conical or stepped, round to square."""
    sides = int(rng.choice([6, 8, 10, 12], p=[0.1, 0.3, 0.4, 0.2]))
    top = radius * rng.uniform(0.5, 0.9)
    step = rng.uniform(0.9, 2.2)
    if rng.random() < 0.35 and height > 2 * step:  # a wide lower part with the door
        neck = radius * rng.uniform(0.6, 0.75)
        profile = [[radius, -UNDERGROUND], [radius, step], [neck, step + 0.12], [min(top, neck), height], [0, height]]
    else:
        profile = [[radius, -UNDERGROUND], [radius, 0.4], [top, height], [0, height + 0.3 * top]]
    parts = [lathe(profile, surface, sides=sides)]
    foot = rng.random()
    if foot < 0.4:  # flange with anchor bolts
        width = radius * rng.uniform(3.4, 4.6)
        thick = rng.uniform(0.015, 0.04)
        parts.append(box([width, width, thick + 0.1], [0, 0, thick / 2 - 0.05], surface))
        for sx in (-1, 1):
            for sy in (-1, 1):
                at = 0.38 * width * np.array([sx, sy])
                parts.append(box([0.03, 0.03, 0.05], [at[0], at[1], thick + 0.025], surface))
    elif foot < 0.55:  # block of concrete
        wide, tall = radius * rng.uniform(4.0, 5.5), rng.uniform(0.06, 0.3)
        block = replace(tinted((0.42, 0.40, 0.37), "light_pole", 0.38, rng), label=surface.label)
        middle = (tall - UNDERGROUND) / 2
        parts.append(box([wide, wide, tall + UNDERGROUND], [0, 0, middle], block, taper=rng.uniform(0.8, 1.0)))
    elif foot < 0.8:  # door or fuse box
        low, tall = rng.uniform(0.35, 0.7), rng.uniform(0.25, 0.45)
        parts.append(box([0.03, radius, tall], [-radius, 0, low + tall / 2], surface))
    return join(parts)


def arm(start: ArrayLike, reach: float, rise: float, bend: float, surface: Surface, radius: float) -> Mesh:
    """Return an arm along +x that leaves its mast steeply and ends flat.

    `reach` and `rise` are the place of its end from its `start`, metres; `bend` is 0 for a straight arm and 1 for a
    quarter of an ellipse; `radius` is that at its beginning.
    """
    f = np.linspace(0, 1, 7 if bend > 0.05 else 2)
    lift = (1 - bend) * f + bend * np.sqrt(np.maximum(1 - (1 - f) ** 2, 0))
    path = np.asarray(start, dtype=np.float64) + np.column_stack([reach * f, 0 * f, rise * lift])
    return tube(path, np.linspace(radius, 0.7 * radius, len(f)), surface, sides=6)


def luminaire(rng: np.random.Generator, at: ArrayLike, surface: Surface, *, pitch: float = 0.0) -> Mesh:
    """Return a street lamp's head, 0.4 to 0.95 m long, at the end of an arm along +x, tilted up by `pitch`, radians."""
    length, width = rng.uniform(0.45, 0.9), rng.uniform(0.18, 0.36)
    lens = tinted((0.6, 0.6, 0.56), "light_pole", 0.45, rng)
    kind = int(rng.integers(3))
    if kind == 0:  # cobra head: slim at the arm, bulging below
        thick = rng.uniform(0.1, 0.17)
        f = np.array([0.0, 0.12, 0.4, 0.75, 0.95, 1.0])
        wide = width * np.array([0.25, 0.4, 0.95, 1.0, 0.75, 0.45])
        tall = thick * np.array([0.5, 0.7, 1.0, 0.95, 0.6, 0.3])
        turn = np.arange(8) * np.pi / 4
        sections = np.stack(
            [np.column_stack([np.full(8, length * x), w / 2 * np.cos(turn), t / 2 * np.sin(turn)])
             for x, w, t in zip(f, wide, tall, strict=True)]
        )  # fmt: skip
        parts = [loft(sections, surface), ellipsoid([0.62 * length, 0, -0.4 * thick], [0.3 * length, 0.4 * width,
                 rng.uniform(0.03, 0.1)], lens, rings=2, sides=6)]  # fmt: skip
    elif kind == 1:  # flat panel of diodes
        thick = rng.uniform(0.05, 0.09)
        parts = [box([length, width, thick], [length / 2, 0, 0], surface, taper=0.9),
                 box([0.7 * length, 0.8 * width, 0.02], [0.55 * length, 0, -thick / 2 - 0.005], lens)]  # fmt: skip
    else:  # bell with a drop lens
        r = width * rng.uniform(0.7, 1.0)
        bell = [[0.2 * r, 0.12], [0.45 * r, 0.08], [r, -0.05]]
        parts = [lathe(bell, surface, at=[r, 0, 0], sides=10),
                 ellipsoid([r, 0, -0.05], [0.8 * r, 0.8 * r, 0.5 * r], lens, rings=3, sides=8),
                 tube([[0, 0, 0.05], [r, 0, 0.1]], 0.025, surface, sides=5)]  # fmt: skip
    return join(parts).moved(at, pitch=-pitch)


def banner(rng: np.random.Generator, low: float, radius: float, side: int, fabric: Surface, rod: Surface) -> Mesh:
    """Return a banner of 0.45 to 0.8 m by 1 to 2.2 m between two rods beside a mast; `side` is 1 for +y, -1 for -y."""
    width, tall, bulge = rng.uniform(0.45, 0.8), rng.uniform(1.0, 2.2), rng.uniform(-0.06, 0.06)
    f = np.linspace(0, 1, 5)
    grid = np.empty((5, 2, 3))
    grid[:, :, 0] = (bulge * np.sin(np.pi * f))[:, None]
    grid[:, :, 1] = side * np.array([radius + 0.05, radius + 0.05 + width])
    grid[:, :, 2] = (low + tall * f)[:, None]
    front = loft(np.concatenate([grid - [0.004, 0, 0], grid[:, ::-1] + [0.004, 0, 0]], axis=1), fabric)
    rods = [tube([[0, 0, z], [0, side * (radius + width + 0.1), z]], 0.014, rod, sides=4) for z in (low, low + tall)]
    return join([front, *rods])


def ballast(rng: np.random.Generator, at: ArrayLike, surface: Surface) -> Mesh:
    """Return a control box strapped to a mast."""
    size = rng.uniform([0.1, 0.2, 0.25], [0.2, 0.4, 0.6])
    return box(size, np.asarray(at, dtype=np.float64) - [size[0] / 2, 0, 0], surface)
