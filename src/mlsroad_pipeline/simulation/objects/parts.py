"""Solids that designs of built things share: skins of quadrilaterals, bodies of revolution, plates that face +x."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.meshes import DIFFUSE, Mesh, Surface, join, rotation_matrix
from mlsroad_pipeline.simulation.model.solids import plate

UNDERGROUND = 0.3
"""How far masts and feet reach below the ground, so that a sloping street leaves no gap, metres."""

_SLIVER = 1e-9  # faces below this area are left out, square metres


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
    """Return the skin over a grid of points, each cell of its own surface; cells without area are left out.

    Parameters
    ----------
    points : array-like of shape (k, m, 3)
        The grid, metres. A cell's front is where its corners (i, j), (i, j + 1), (i + 1, j + 1) run counter-clockwise.
    surfaces : sequence of Surface
        What cells are made of.
    which : array-like of int, broadcastable to (k - 1, m - 1), default 0
        Number of the surface of each cell, -1 for a hole.

    Returns
    -------
    Mesh
        At most 2 (k - 1) (m - 1) faces.
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
    """Return the mesh without the faces that have no area."""
    corners = mesh.vertices[mesh.faces]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    cross = (a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]) ** 2
    cross += (a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]) ** 2 + (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) ** 2
    kept = cross > (2 * _SLIVER) ** 2
    if kept.all():
        return mesh
    return Mesh(mesh.vertices, mesh.faces[kept], mesh.attributes[kept])


def lathe(profile: ArrayLike, surface: Surface, *, at: ArrayLike = (0.0, 0.0, 0.0), sides: int = 10) -> Mesh:
    """Return a body of revolution about an upright axis.

    Parameters
    ----------
    profile : array-like of shape (k, 2)
        Radius and height of its outline, from the lowest up, metres; it is open where it does not begin or end at 0.
    surface : Surface
        What it is made of.
    at : array-like of shape (3,), default the origin
        Where height 0 of its axis is, metres.
    sides : int, default 10
        Corners of the cross-section.

    Returns
    -------
    Mesh
        At most 2 (k - 1) sides faces.
    """
    r, z = np.asarray(profile, dtype=np.float64).T
    angle = np.arange(sides + 1) * (2 * np.pi / sides)
    angle[-1] = 0.0
    x, y = r[:, None] * np.cos(angle), r[:, None] * np.sin(angle)
    points = np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], axis=2)
    return grid_skin(points + np.asarray(at, dtype=np.float64), [surface])


def loft(sections: ArrayLike, surface: Surface, *, closed: bool = True) -> Mesh:
    """Return the skin over a row of convex cross-sections.

    Parameters
    ----------
    sections : array-like of shape (k, m, 3)
        Corners of each, going round, metres.
    surface : Surface
        What it is made of.
    closed : bool, default True
        Whether the first and the last are closed.

    Returns
    -------
    Mesh
        The skin.
    """
    rings = np.asarray(sections, dtype=np.float64)
    skin = grid_skin(np.concatenate([rings, rings[:, :1]], axis=1), [surface])
    if not closed:
        return skin
    return join([skin, fan(rings[0, ::-1], surface), fan(rings[-1], surface)])


def fan(corners: ArrayLike, surface: Surface) -> Mesh:
    """Return a convex polygon as triangles about its first corner.

    Parameters
    ----------
    corners : array-like of shape (m, 3)
        Going round, counter-clockwise as seen from its front, metres.
    surface : Surface
        What it is made of.

    Returns
    -------
    Mesh
        At most m - 2 faces.
    """
    points = np.asarray(corners, dtype=np.float64)
    m = len(points)
    faces = np.stack([np.zeros(m - 2, dtype=np.int64), np.arange(1, m - 1), np.arange(2, m)], axis=1)
    return without_slivers(Mesh(points, faces, surface.rows(m - 2)))


def prism(outline: ArrayLike, width: float, surface: Surface, *, at: float = 0.0) -> Mesh:
    """Return a convex outline of the xz plane made `width` thick along y.

    Parameters
    ----------
    outline : array-like of shape (m, 2)
        x and z of its corners, going round, metres.
    width : float
        Metres.
    surface : Surface
        What it is made of.
    at : float, default 0
        y of its middle, metres.

    Returns
    -------
    Mesh
        The prism, closed.
    """
    flat = np.asarray(outline, dtype=np.float64)
    sections = np.empty((2, len(flat), 3))
    sections[:, :, [0, 2]] = flat
    sections[:, :, 1] = np.array([[at + width / 2], [at - width / 2]])
    return loft(sections, surface)


def rounded(width: float, height: float, radius: float) -> NDArray[np.float64]:
    """Return the outline of a rectangle with rounded corners about the origin.

    Parameters
    ----------
    width, height : float
        Its sides, metres.
    radius : float
        Of its corners, metres; at most half of the shorter side.

    Returns
    -------
    ndarray of shape (12, 2), float64
        The corners, counter-clockwise.
    """
    turn = np.array([0.0, np.pi / 4, np.pi / 2])
    corners = []
    for k, (sx, sy) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)]):
        middle = [sx * (width / 2 - radius), sy * (height / 2 - radius)]
        angle = turn + k * np.pi / 2
        corners.append(np.array(middle) + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    return np.concatenate(corners)


def panel(outline: ArrayLike, front: Surface, back: Surface, at: ArrayLike, *, yaw: float = 0.0) -> Mesh:
    """Return an upright convex plate.

    Parameters
    ----------
    outline : array-like of shape (m, 2)
        Its corners about its middle, to the right and up as seen from its front, counter-clockwise, metres.
    front, back : Surface
        What its two faces are made of.
    at : array-like of shape (3,)
        Its middle, metres.
    yaw : float, default 0
        Where its front looks, radians counter-clockwise from +x.

    Returns
    -------
    Mesh
        The two faces.
    """
    return plate(outline, front, back).moved(at, yaw=yaw + np.pi / 2)


def rectangle(width: float, height: float) -> NDArray[np.float64]:
    """Return the corners of a rectangle about the origin, counter-clockwise."""
    return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array([width / 2, height / 2])


def leaned(mesh: Mesh, rng: np.random.Generator, *, share: float = 0.25, limit: float = 3.0) -> Mesh:
    """Return the mesh tilted about its foot: most masts by a fraction of a degree, some visibly.

    Parameters
    ----------
    mesh : Mesh
        What stands upright at the origin.
    rng : numpy.random.Generator
        Source of direction and angle.
    share : float, default 0.25
        How many lean visibly, by 0.5 degrees or more.
    limit : float, default 3
        The largest tilt, degrees.

    Returns
    -------
    Mesh
        The tilted one.
    """
    strong, direction = rng.random() < share, rng.uniform(0, 2 * np.pi)
    angle = np.radians(rng.uniform(0.5, limit) if strong else min(abs(rng.normal(0, 0.2)), limit))
    # A turn about a horizontal axis.
    turn = rotation_matrix(direction, 0, 0) @ rotation_matrix(0, angle, 0) @ rotation_matrix(-direction, 0, 0)
    return Mesh(mesh.vertices @ turn.T, mesh.faces, mesh.attributes)


def tinted(
    rgb: tuple[float, float, float], label: str, reflectivity: float, rng: np.random.Generator, *, spread: float = 0.15,
    kind: int = DIFFUSE,
) -> Surface:  # fmt: skip
    """Return a surface near a colour that the table of materials does not have.

    Parameters
    ----------
    rgb : tuple of float
        Albedo, 0 to 1 and linear.
    label : str
        Taxonomy class.
    reflectivity : float
        Albedo at the scanner's wavelength, 0 to 1.
    rng : numpy.random.Generator
        Source of its own shade.
    spread : float, default 0.15
        Standard deviation of the logarithm of tone and reflectivity; that of the hue is a third of it.
    kind : int, default DIFFUSE
        One of the kinds of `meshes`.

    Returns
    -------
    Surface
        The surface.
    """
    tone, infrared = np.exp(rng.normal(0, spread, 2))
    r, g, b = (float(c) for c in np.clip(np.array(rgb) * tone * np.exp(rng.normal(0, spread / 3, 3)), 0.005, 0.95))
    return Surface(TAXONOMY[label], (r, g, b), float(np.clip(reflectivity * infrared, 0.02, 0.95)), kind)
