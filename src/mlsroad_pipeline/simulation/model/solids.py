"""Basic solids of street objects."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.simulation.model.meshes import RED, Mesh, Surface, join

_BOX_FACES = np.array([
    [0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4],
    [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7],
])  # fmt: skip
_BOX_CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]]
)


def box(size: ArrayLike, centre: ArrayLike, surface: Surface, *, taper: float = 1.0) -> Mesh:
    """Return a cuboid; its top is `taper` times as wide and deep as its bottom."""
    corners = _BOX_CORNERS * (np.asarray(size, dtype=np.float64) / 2)
    corners[4:, :2] *= taper
    return Mesh(corners + np.asarray(centre, dtype=np.float64), _BOX_FACES.astype(np.int64), surface.rows(12))


def quads(corners: ArrayLike, surface: Surface) -> Mesh:
    """Return quadrilaterals with corners of shape (q, 4, 3), each in cyclic order."""
    points = np.asarray(corners, dtype=np.float64).reshape(-1, 4, 3)
    first = np.arange(0, 4 * len(points), 4)[:, None, None]
    faces = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return Mesh(points.reshape(-1, 3), faces, surface.rows(len(faces)))


def tube(path: ArrayLike, radius: ArrayLike, surface: Surface, *, sides: int = 8) -> Mesh:
    """Return a round bar along a polyline of shape (m, 3), closed at both ends; `radius` may vary along it."""
    points = np.asarray(path, dtype=np.float64)
    radii = np.broadcast_to(np.asarray(radius, dtype=np.float64), (len(points),))
    tangents = np.empty_like(points)
    tangents[1:-1] = points[2:] - points[:-2]
    tangents[[0, -1]] = points[[1, -1]] - points[[0, -2]]
    # One reference direction for the whole bar avoids twists.
    reference = np.zeros(3)
    reference[np.abs(tangents).max(axis=0).argmin()] = 1.0
    u = _unit(_cross(tangents, reference))
    v = _unit(_cross(tangents, u))
    angle = np.arange(sides) * (2 * np.pi / sides)
    ring = u[:, None] * np.cos(angle)[:, None] + v[:, None] * np.sin(angle)[:, None]
    vertices = np.concatenate([(points[:, None] + radii[:, None, None] * ring).reshape(-1, 3), points[[0, -1]]])
    faces = _tube_faces(len(points), sides)
    return Mesh(vertices, faces, surface.rows(len(faces)))


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return vectors / (np.sqrt((vectors * vectors).sum(axis=1, keepdims=True)) + 1e-12)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    # numpy.cross takes ten times as long for such small arrays.
    ax, ay, az = a.T
    bx, by, bz = b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


@cache
def _tube_faces(m: int, sides: int) -> NDArray[np.int64]:
    k, j = (grid.ravel() for grid in np.meshgrid(np.arange(m - 1), np.arange(sides), indexing="ij"))
    a, b = k * sides + j, k * sides + (j + 1) % sides
    side = np.concatenate([np.stack([a, b, b + sides], 1), np.stack([a, b + sides, a + sides], 1)])
    rim = np.arange(sides)
    last, ends = (m - 1) * sides, m * sides
    bottom = np.stack([(rim + 1) % sides, rim, np.full(sides, ends)], 1)
    top = np.stack([last + rim, last + (rim + 1) % sides, np.full(sides, ends + 1)], 1)
    faces = np.concatenate([side, bottom, top])
    faces.setflags(write=False)  # shared by every bar of this shape
    return faces


def ellipsoid(centre: ArrayLike, radii: ArrayLike, surface: Surface, *, rings: int = 5, sides: int = 8) -> Mesh:
    """Return a closed ellipsoid with upright axis; `rings` are its circles of latitude between the poles."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, rings + 2)
    path = np.stack([np.zeros(rings + 2), np.zeros(rings + 2), np.sin(latitude)], 1)
    unit = tube(path, np.maximum(np.cos(latitude), 1e-3), surface, sides=sides)
    return Mesh(unit.vertices * np.asarray(radii) + np.asarray(centre), unit.faces, unit.attributes)


def plate(outline: ArrayLike, front: Surface, back: Surface, *, thickness: float = 0.004) -> Mesh:
    """Return a convex plate in the xz plane whose front faces -y; the rim between its two faces is open."""
    flat = np.asarray(outline, dtype=np.float64)
    m = len(flat)
    sheets = []
    for y, surface in ((-thickness / 2, front), (thickness / 2, back)):
        vertices = np.stack([flat[:, 0], np.full(m, y), flat[:, 1]], 1)
        fan = np.stack([np.zeros(m - 2, dtype=np.int64), np.arange(1, m - 1), np.arange(2, m)], 1)
        sheets.append(Mesh(vertices, fan, surface.rows(m - 2)))
    return join(sheets)


def leaves(
    centres: ArrayLike, directions: ArrayLike, length: ArrayLike, width: ArrayLike, surface: Surface,
    rng: np.random.Generator,
) -> Mesh:  # fmt: skip
    """Return one quadrilateral leaf per centre, rotated at random about its direction, each of its own colour."""
    middle = np.asarray(centres, dtype=np.float64)
    along = np.asarray(directions, dtype=np.float64)
    along = along / (np.linalg.norm(along, axis=1, keepdims=True) + 1e-12)
    across = np.cross(along, rng.normal(size=along.shape))
    across /= np.linalg.norm(across, axis=1, keepdims=True) + 1e-12
    half_l = along * np.broadcast_to(np.asarray(length) / 2, (len(middle),))[:, None]
    half_w = across * np.broadcast_to(np.asarray(width) / 2, (len(middle),))[:, None]
    corners = np.stack([middle - half_l, middle + half_w, middle + half_l, middle - half_w], axis=1)
    mesh = quads(corners, surface)
    tone = np.repeat(rng.normal(1.0, 0.18, (len(middle), 1)), 2, axis=0).clip(0.4, 1.7)
    hue = np.repeat(rng.normal(1.0, 0.06, (len(middle), 4)), 2, axis=0).clip(0.7, 1.4)
    mesh.attributes[:, RED:] = (mesh.attributes[:, RED:] * tone * hue).clip(0.01, 0.98)
    return mesh


def polygon(n: int, radius: float, *, start: float = 0.0) -> NDArray[np.float64]:
    """Return the corners of a regular polygon about the origin, counter-clockwise from the direction `start`."""
    angle = start + np.arange(n) * 2 * np.pi / n
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
