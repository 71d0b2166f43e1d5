"""The designs of built things, and slow, obvious measures on their meshes."""

from functools import cache

import numpy as np

from mlsroad_pipeline.simulation.objects import (
    bus_stops,
    cars,
    gantries,
    light_poles,
    street_furniture,
    traffic_lights,
    traffic_signs,
    utility_poles,
    vans_trucks,
)

MODULES = (
    light_poles, utility_poles, traffic_signs, gantries, traffic_lights, bus_stops, street_furniture, cars, vans_trucks,
)  # fmt: skip


DESIGNS = {design.name: design for module in MODULES for design in module.DESIGNS}


POLES = [d.name for m in (light_poles, utility_poles, traffic_signs, traffic_lights) for d in m.DESIGNS]


VEHICLES = [d.name for m in (cars, vans_trucks) for d in m.DESIGNS]


STREAMS = range(4)


@cache
def built(name, stream):
    """Return the mesh of a design and a stream."""
    return DESIGNS[name].build(np.random.default_rng([11, stream]))


def areas(mesh):
    """Return the areas of the faces."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    sides = [np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (c, a))]
    half = sum(sides) / 2
    return np.sqrt(np.maximum(half * np.prod([half - s for s in sides], axis=0), 0))  # Heron


def used(mesh):
    """Return the vertices of the faces."""
    return mesh.vertices[np.unique(mesh.faces)]


def along(mesh, origin, direction):
    """Return the distances of a ray's hits on a mesh, nearest first, and their faces (Moeller and Trumbore)."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    e1, e2 = b - a, c - a
    p = np.cross(direction, e2)
    det = np.einsum("ij,ij->i", e1, p)
    det = np.where(np.abs(det) < 1e-12, np.nan, det)
    s = origin - a
    u = np.einsum("ij,ij->i", s, p) / det
    q = np.cross(s, e1)
    v = q @ direction / det
    t = np.einsum("ij,ij->i", e2, q) / det
    hit = np.flatnonzero((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0))
    order = np.argsort(t[hit])
    return t[hit][order], hit[order]


def section_middle(mesh, z):
    """Return the middle of the section of a mesh at a height."""
    triangles = mesh.vertices[mesh.faces]
    points = []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        p, q = triangles[:, a], triangles[:, b]
        f = (z - p[:, 2]) / np.where(q[:, 2] == p[:, 2], np.nan, q[:, 2] - p[:, 2])
        hit = (f >= 0) & (f <= 1)
        points.append((p + f[:, None] * (q - p))[hit, :2])
    points = np.concatenate(points)
    return (points.max(axis=0) + points.min(axis=0)) / 2
