"""Slow, obvious re-implementations for the simulator's tests."""

import numpy as np
from numba import njit
from scipy.spatial import ConvexHull

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.rays.scene import RayScene, build_static, triangle_soup
from mlsroad_pipeline.simulation.street.cover import ground_cover
from mlsroad_pipeline.simulation.street.ground import Nearby, nearby

GROUND_LABELS = [
    TAXONOMY[name]
    for name in ("road", "lane_marking", "parking", "sidewalk", "curb", "manhole", "grass", "soil", "other_ground")
]


def scene_of(street, meshes, instances, movers, centre, *, wetness=0.0):
    """Return a scene of meshes with their instance numbers and of moving objects."""
    static = [build_static(triangle_soup(meshes, instances, centre, heading=0.0))]
    return RayScene(street, static, movers, centre, wetness=wetness)


def ground_labels(ground, station, offset):
    """Return the taxonomy codes of the ground at stations and offsets, which broadcast."""
    s, left = np.broadcast_arrays(np.asarray(station, dtype=np.float64), np.asarray(offset, dtype=np.float64))
    return _labels(s.ravel(), left.ravel(), ground).reshape(s.shape)


@njit(nogil=True, error_model="numpy")
def _labels(s, left, g):
    codes = np.empty(len(s), dtype=np.uint8)
    for i in range(len(s)):
        near = nearby(s[i], g, Nearby(0, 0, 0))
        codes[i] = ground_cover(s[i], left[i], g, near)[0]
    return codes


def first_triangle(origin, direction, vertices, faces):
    """Return distance and face of the first triangle on a ray (Moeller and Trumbore), or infinity and -1."""
    best, found = np.inf, -1
    for k, (a, b, c) in enumerate(vertices[faces]):
        p = np.cross(direction, c - a)
        determinant = np.dot(b - a, p)
        if abs(determinant) < 1e-12:
            continue
        s = origin - a
        u = np.dot(s, p) / determinant
        q = np.cross(s, b - a)
        v = np.dot(direction, q) / determinant
        t = np.dot(c - a, q) / determinant
        if u >= 0 and v >= 0 and u + v <= 1 and 0 < t < best:
            best, found = t, k
    return best, found


def enclosed_volume(vertices, faces):
    """Return the volume of a closed mesh with outward faces, by the divergence theorem."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def nearest_image_colour(point, time, images, depths):
    """Return the colour of a point in the temporally nearest image that shows it, or None; ties go to the earlier."""

    def key(j):
        before = images[j].time < time
        return abs(images[j].time - time), not before, -j if before else j

    for j in sorted(range(len(images)), key=key):
        image = images[j]
        seen = image.R @ point + image.t
        if seen[2] < 0.3:
            continue
        x, y = seen[:2] / seen[2]
        if x * x + y * y > 2.0:  # far beyond the corners, where the lens polynomial is not monotonic
            continue
        u, v, _ = np.floor(image.K @ [*brown_conrady(x, y, image.distortion), 1.0] + 0.5).astype(int)
        if not (0 <= u < image.width and 0 <= v < image.height):
            continue
        if seen[2] <= depths[j][v, u] * 1.01 + 0.06:
            return image.rgb[v, u]
    return None


def brown_conrady(x, y, distortion):
    """Distort a place in the image plane by the printed formula."""
    k1, k2, p1, p2, k3 = distortion
    r = np.hypot(x, y)
    radial = 1 + k1 * r**2 + k2 * r**4 + k3 * r**6
    return (
        x * radial + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2),
        y * radial + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y,
    )


def curb_distance_by_sampling(s, left, half, arm):
    """Return distances to the curb of a straight street with one side street at right angles.

    The curb is drawn as points a millimetre apart: straight lines, and arcs of the arm's radius that touch both.
    """
    station, wide, radius = arm[[0, 2, 3]]
    angle = np.linspace(0, np.pi / 2, 12000)
    straight = np.arange(radius, 80, 0.001)
    x = np.concatenate([np.zeros_like(straight), radius - radius * np.cos(angle), straight])
    y = np.concatenate([straight[::-1], radius - radius * np.sin(angle), np.zeros_like(straight)])
    curb = np.concatenate([np.stack([k * (wide + y), x], axis=1) for k in (-1, 1)])
    out = np.abs(left) - half
    distances = []
    for q, t in zip(s - station, out, strict=True):
        nearest = np.sqrt(((curb - [q, t]) ** 2).sum(axis=1).min())
        corner = t < radius and abs(q) < wide + radius
        paved = t <= 0 or abs(q) <= wide
        if corner and not paved:
            paved = np.hypot(radius - t, wide + radius - abs(q)) >= radius
        distances.append(-nearest if paved else nearest)
    return np.array(distances)


def hulls_overlap(a, b):
    """Return whether the convex hulls of two sets of points of the plane overlap (no axis of either separates them)."""
    hulls = [points[ConvexHull(points).vertices] for points in (a, b)]
    for hull in hulls:
        edges = np.roll(hull, -1, axis=0) - hull
        for normal in np.stack([-edges[:, 1], edges[:, 0]], axis=1):
            first, second = (h @ normal for h in hulls)
            if first.max() <= second.min() or second.max() <= first.min():
                return False
    return True
