"""Batches of bars and leaves, for plants and bodies, without a loop over their parts."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.simulation.model.meshes import RED, Mesh, Surface, join

Floats = NDArray[np.float64]


def unit(vectors: ArrayLike) -> Floats:
    """Return vectors of length one."""
    v = np.asarray(vectors, dtype=np.float64)
    return v / (np.sqrt((v * v).sum(axis=-1, keepdims=True)) + 1e-12)


def bearing(azimuth: ArrayLike, elevation: ArrayLike) -> Floats:
    """Return unit vectors from azimuths (from +x, counter-clockwise) and elevations, radians."""
    a, e = np.broadcast_arrays(np.asarray(azimuth, dtype=np.float64), np.asarray(elevation, dtype=np.float64))
    return np.stack([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)], axis=-1)


def bows(start: Floats, heading: Floats, end: Floats, steps: int, *, ease: float = 0.45) -> Floats:
    """Return quadratic Bezier curves of `steps` points that leave `start` along `heading` and bend towards `end`.

    `ease` is the distance over which the first direction holds, over that between the ends: 0 is straight.
    """
    reach = np.sqrt(((end - start) ** 2).sum(axis=1, keepdims=True))
    middle = start + ease * reach * heading
    t = np.linspace(0.0, 1.0, steps)[:, None]
    return ((1 - t) ** 2) * start[:, None] + (2 * t * (1 - t)) * middle[:, None] + t**2 * end[:, None]


def tubes(
    paths: ArrayLike, radii: ArrayLike, surfaces: Surface | Sequence[Surface], *, sides: int = 5, closed: bool = False,
    flatten: ArrayLike | None = None,
) -> Mesh:  # fmt: skip
    """Return round bars along n polylines of m points each."""
    points = np.asarray(paths, dtype=np.float64)
    n, m = points.shape[:2]
    if n == 0:
        return join([])
    radius = np.broadcast_to(np.asarray(radii, dtype=np.float64), (n, m))
    tangents = np.empty_like(points)
    tangents[:, 1:-1] = points[:, 2:] - points[:, :-2]
    tangents[:, 0], tangents[:, -1] = points[:, 1] - points[:, 0], points[:, -1] - points[:, -2]
    # One reference direction per bar, the axis least parallel to it, avoids twists.
    reference = np.eye(3)[np.abs(tangents).max(axis=1).argmin(axis=1)][:, None]
    u = unit(np.cross(tangents, reference))
    v = unit(np.cross(tangents, u))
    angle = np.arange(sides) * (2 * np.pi / sides)
    ring = u[:, :, None] * np.cos(angle)[:, None] + v[:, :, None] * np.sin(angle)[:, None]
    ring = ring * radius[:, :, None, None]
    if flatten is not None:
        ring[..., 1] *= np.broadcast_to(np.asarray(flatten, dtype=np.float64), (n, m))[:, :, None]
    vertices = (points[:, :, None] + ring).reshape(-1, 3)
    pattern = _bar_faces(m, sides, closed)
    faces = (pattern + (np.arange(n) * (m * sides))[:, None, None]).reshape(-1, 3)
    if isinstance(surfaces, Surface):
        return Mesh(vertices, faces, surfaces.rows(len(faces)))
    return Mesh(vertices, faces, np.repeat(np.concatenate([s.rows(1) for s in surfaces]), len(pattern), axis=0))


@cache
def _bar_faces(m: int, sides: int, closed: bool) -> NDArray[np.int64]:
    k, j = (grid.ravel() for grid in np.meshgrid(np.arange(m - 1), np.arange(sides), indexing="ij"))
    a, b = k * sides + j, k * sides + (j + 1) % sides
    parts = [np.stack([a, b, b + sides], 1), np.stack([a, b + sides, a + sides], 1)]
    if closed:
        fan = np.stack([np.zeros(sides - 2, dtype=np.int64), np.arange(1, sides - 1), np.arange(2, sides)], 1)
        parts += [fan[:, ::-1], fan + (m - 1) * sides]
    faces = np.concatenate(parts)
    faces.setflags(write=False)  # shared by every bar of this shape
    return faces


def blades(
    roots: ArrayLike, directions: ArrayLike, length: ArrayLike, width: ArrayLike, surface: Surface,
    rng: np.random.Generator, *, across: ArrayLike | None = None, spread: float = 0.18,
) -> Mesh:  # fmt: skip
    """Return one triangle per leaf, wide at its root and pointed at its tip, each of its own colour.

    Roots and directions are (n, 3); `across` is the direction of each leaf's width (random by default), `spread` the
    standard deviation of the leaves' brightness about the average.
    """
    root = np.asarray(roots, dtype=np.float64)
    n = len(root)
    along = unit(directions)
    side = unit(np.cross(along, rng.normal(size=along.shape))) if across is None else unit(across)
    half = side * np.broadcast_to(np.asarray(width) / 2, (n,))[:, None]
    tip = root + along * np.broadcast_to(np.asarray(length), (n,))[:, None]
    mesh = Mesh(
        np.stack([root - half, root + half, tip], axis=1).reshape(-1, 3), np.arange(3 * n).reshape(n, 3),
        surface.rows(n),
    )  # fmt: skip
    tone = rng.normal(1.0, spread, (n, 1)).clip(0.4, 1.7)
    hue = rng.normal(1.0, 0.06, (n, 4)).clip(0.7, 1.4)
    mesh.attributes[:, RED:] = (mesh.attributes[:, RED:] * tone * hue).clip(0.01, 0.98)
    return mesh


def scatter(rng: np.random.Generator, n: int, *, shell: float = 0.0) -> Floats:
    """Draw n places in the unit ball; `shell` 0 fills it evenly, larger values crowd them to its surface."""
    return unit(rng.normal(size=(n, 3))) * rng.random((n, 1)) ** (1 / (3 + shell))


def lift(mesh: Mesh, *, margin: float = 0.1) -> Mesh:
    """Bend vertices below a height `margin` upwards, so that all are above z = 0 and keep their order of height."""
    vertices = mesh.vertices.copy()
    low = vertices[:, 2] < margin
    vertices[low, 2] = margin * np.exp(np.maximum(vertices[low, 2] / margin - 1, -20.0))
    return Mesh(vertices, mesh.faces, mesh.attributes)
