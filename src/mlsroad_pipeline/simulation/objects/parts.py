"""Solids of built objects: skins of quadrilaterals, bodies of revolution, plates that face +x."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.meshes import DIFFUSE, Mesh, Surface, join, rotation_matrix
from mlsroad_pipeline.simulation.model.solids import fan_faces, plate

UNDERGROUND = 0.3
"""Depth of masts and feet below the ground, so that a sloping street leaves no gap, metres."""

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
