"""Basic solids of street objects: one at a time, and in batches without a loop over their parts."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.simulation.model.meshes import RED, Mesh, Surface, join

Floats = NDArray[np.float64]

GOLDEN = 2.39996  # Golden angle between successive leaves or branches, radians
_BOX_FACES = np.array([
    [0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4],
    [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7],
])  # fmt: skip
BOX_CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]]
)


def box(size: ArrayLike, centre: ArrayLike, surface: Surface, *, taper: float = 1.0) -> Mesh:
    """Return a cuboid; its top is `taper` times as wide and deep as its bottom."""
    corners = BOX_CORNERS * (np.asarray(size, dtype=np.float64) / 2)
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
    rings = (points[:, None] + _rings(points[None], radii[None], sides)[0]).reshape(-1, 3)
    faces = _bar_faces(len(points), sides, "points")
    return Mesh(np.concatenate([rings, points[[0, -1]]]), faces, surface.rows(len(faces)))


def tubes(
    paths: ArrayLike, radii: ArrayLike, surfaces: Surface | Sequence[Surface], *, sides: int = 5, closed: bool = False,
    flatten: ArrayLike | None = None,
) -> Mesh:  # fmt: skip
    """Return round bars along n polylines of m points each."""
    points = np.asarray(paths, dtype=np.float64)
    n, m = points.shape[:2]
    if n == 0:
        return join([])
    ring = _rings(points, np.broadcast_to(np.asarray(radii, dtype=np.float64), (n, m)), sides)
    if flatten is not None:
        ring[..., 1] *= np.broadcast_to(np.asarray(flatten, dtype=np.float64), (n, m))[:, :, None]
    vertices = (points[:, :, None] + ring).reshape(-1, 3)
    pattern = _bar_faces(m, sides, "fans" if closed else "open")
    faces = (pattern + (np.arange(n) * (m * sides))[:, None, None]).reshape(-1, 3)
    if isinstance(surfaces, Surface):
        return Mesh(vertices, faces, surfaces.rows(len(faces)))
    return Mesh(vertices, faces, np.repeat(np.concatenate([s.rows(1) for s in surfaces]), len(pattern), axis=0))


def _rings(points: Floats, radius: Floats, sides: int) -> Floats:
    """Return the cross-sections of bars about their axes, shape (n, m, sides, 3)."""
    tangents = np.empty_like(points)
    tangents[:, 1:-1] = points[:, 2:] - points[:, :-2]
    tangents[:, 0], tangents[:, -1] = points[:, 1] - points[:, 0], points[:, -1] - points[:, -2]
    # One reference direction per bar, the axis least parallel to it, avoids twists.
    reference = np.eye(3)[np.abs(tangents).max(axis=1).argmin(axis=1)][:, None]
    u = unit(_cross(tangents, reference))
    v = unit(_cross(tangents, u))
    angle = np.arange(sides) * (2 * np.pi / sides)
    ring = u[:, :, None] * np.cos(angle)[:, None] + v[:, :, None] * np.sin(angle)[:, None]
    return np.asarray(ring * radius[:, :, None, None])


def _cross(a: Floats, b: Floats) -> Floats:
    # numpy.cross takes ten times as long for such small arrays.
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


@cache
def _bar_faces(m: int, sides: int, ends: str) -> NDArray[np.int64]:
    """Return the faces of a bar of m rings: with open ends, with fans, or with points that follow the rings."""
    k, j = (grid.ravel() for grid in np.meshgrid(np.arange(m - 1), np.arange(sides), indexing="ij"))
    a, b = k * sides + j, k * sides + (j + 1) % sides
    parts = [np.stack([a, b, b + sides], 1), np.stack([a, b + sides, a + sides], 1)]
    rim, last = np.arange(sides), (m - 1) * sides
    after = (rim + 1) % sides
    if ends == "fans":
        parts += [fan_faces(sides)[:, ::-1], fan_faces(sides) + last]
    elif ends == "points":
        tips = np.full(sides, m * sides)
        parts += [np.stack([after, rim, tips], 1), np.stack([last + rim, last + after, tips + 1], 1)]
    faces = np.concatenate(parts)
    faces.setflags(write=False)  # shared by every bar of this shape
    return faces


def fan_faces(m: int) -> NDArray[np.int64]:
    """Return the triangles of a convex polygon of m corners about its first one."""
    return np.stack([np.zeros(m - 2, dtype=np.int64), np.arange(1, m - 1), np.arange(2, m)], axis=1)


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
        sheets.append(Mesh(vertices, fan_faces(m), surface.rows(m - 2)))
    return join(sheets)


def leaves(
    centres: ArrayLike, directions: ArrayLike, length: ArrayLike, width: ArrayLike, surface: Surface,
    rng: np.random.Generator,
) -> Mesh:  # fmt: skip
    """Return one quadrilateral leaf per centre, rotated at random about its direction, each of its own colour."""
    middle = np.asarray(centres, dtype=np.float64)
    along = unit(directions)
    across = unit(np.cross(along, rng.normal(size=along.shape)))
    half_l = along * np.broadcast_to(np.asarray(length) / 2, (len(middle),))[:, None]
    half_w = across * np.broadcast_to(np.asarray(width) / 2, (len(middle),))[:, None]
    corners = np.stack([middle - half_l, middle + half_w, middle + half_l, middle - half_w], axis=1)
    mesh = quads(corners, surface)
    return _coloured(mesh, rng, 0.18, faces=2)


def polygon(n: int, radius: float, *, start: float = 0.0) -> NDArray[np.float64]:
    """Return the corners of a regular polygon about the origin, counter-clockwise from the direction `start`."""
    angle = start + np.arange(n) * 2 * np.pi / n
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


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
    return _coloured(mesh, rng, spread, faces=1)


def _coloured(mesh: Mesh, rng: np.random.Generator, spread: float, *, faces: int) -> Mesh:
    """Give each leaf, of one or two faces, its own tone and hue."""
    n = len(mesh.faces) // faces
    tone = np.repeat(rng.normal(1.0, spread, (n, 1)), faces, axis=0).clip(0.4, 1.7)
    hue = np.repeat(rng.normal(1.0, 0.06, (n, 4)), faces, axis=0).clip(0.7, 1.4)
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
