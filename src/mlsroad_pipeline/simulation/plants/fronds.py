"""Fronds of palms and cycads, and the trunks under them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mlsroad_pipeline.simulation.model.batches import Floats, bearing, blades, lift, tubes, unit
from mlsroad_pipeline.simulation.model.meshes import RED, Mesh, Surface, join

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Feather:
    """How a feathered frond is built.

    Parameters
    ----------
    bend : float
        How far its tip has turned down from its first direction, radians.
    leaflets : int
        Leaflets on each side.
    leaflet : float
        Length of the longest over that of the frond.
    width : float
        Of a leaflet, metres.
    lift : float, default 0.0
        How far leaflets rise above the rib on both sides, as a keel does, radians; negative ones hang.
    plumes : float, default 0.1
        Standard deviation of the leaflets' directions: a large one gives a plume, a small one a comb.
    forward : float, default 0.6
        How far leaflets point to the tip.
    bare : float, default 0.12
        Share of the rib without leaflets.
    """

    bend: float
    leaflets: int
    leaflet: float
    width: float
    lift: float = 0.0
    plumes: float = 0.1
    forward: float = 0.6
    bare: float = 0.12


def _ribs(root: Floats, azimuth: Floats, elevation: Floats, length: Floats, bend: Floats, steps: int) -> Floats:
    """Return curves of given lengths that turn down along their way."""
    s = np.linspace(0, 1, steps)
    middle = (s[1:] + s[:-1]) / 2
    angle = elevation[:, None] - bend[:, None] * middle**1.4
    # What has turned past the vertical hangs straight down.
    angle = np.maximum(angle, -1.5)
    step = (length / (steps - 1))[:, None, None] * bearing(azimuth[:, None], angle)
    return root[:, None] + np.concatenate([np.zeros((len(root), 1, 3)), np.cumsum(step, axis=1)], axis=1)


def feathers(
    rng: np.random.Generator, root: ArrayLike, azimuth: ArrayLike, elevation: ArrayLike, length: ArrayLike,
    shape: Feather, leaf: Surface,
) -> Mesh:  # fmt: skip
    """Return fronds with a rib and leaflets on both of its sides.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of all that differs from leaflet to leaflet.
    root : array-like of shape (n, 3) or (3,)
        Where the ribs begin, metres.
    azimuth, elevation : array-like of shape (n,)
        First direction of each rib, radians.
    length : array-like
        Length of each rib, metres; broadcasts to (n,).
    shape : Feather
        How they are built.
    leaf : Surface
        The average leaflet; the rib is a little paler.

    Returns
    -------
    Mesh
        ``24 + 2 leaflets`` faces per frond.
    """
    a, e = np.asarray(azimuth, dtype=np.float64), np.asarray(elevation, dtype=np.float64)
    n, k = len(a), 2 * shape.leaflets
    long = np.broadcast_to(np.asarray(length, dtype=np.float64), (n,))
    start = np.broadcast_to(np.asarray(root, dtype=np.float64), (n, 3))
    bend = shape.bend * rng.uniform(0.75, 1.25, n)
    ribs = _ribs(start, a, e, long, bend, 5)
    pale = Surface(leaf.label, (leaf.rgb[0] * 1.25, leaf.rgb[1] * 1.1, leaf.rgb[2]), leaf.reflectivity, leaf.kind)
    thick = (0.009 * long[:, None] + 0.004) * np.linspace(1, 0.25, 5)
    rib_mesh = tubes(ribs, thick, pale, sides=3)
    # Where the leaflets of each frond sit: alternating, a little uneven.
    s = np.linspace(shape.bare, 1.0, k) + rng.normal(0, 0.2 / k, (n, k))
    s = np.clip(s, 0, 1)
    low = np.minimum((4 * s).astype(np.int64), 3)
    part = (4 * s - low)[..., None]
    row = np.arange(n)[:, None]
    place = (1 - part) * ribs[row, low] + part * ribs[row, low + 1]
    tangent = unit(ribs[row, low + 1] - ribs[row, low])
    side = np.stack([-np.sin(a), np.cos(a), np.zeros(n)], 1)[:, None] * np.where(np.arange(k) % 2, 1.0, -1.0)[:, None]
    over = np.cross(tangent, side) * np.where(np.arange(k) % 2, 1.0, -1.0)[:, None]
    towards = side + shape.forward * (0.5 + s[..., None]) * tangent + np.tan(shape.lift) * over
    towards = towards - 0.15 * _UP + rng.normal(0, shape.plumes, (n, k, 3))
    profile = np.sin(np.pi * np.clip(0.12 + 0.8 * (s - shape.bare) / (1 - shape.bare), 0, 1)) ** 0.7
    size = shape.leaflet * long[:, None] * profile * rng.uniform(0.85, 1.15, (n, k))
    mesh = blades(
        place.reshape(-1, 3), towards.reshape(-1, 3), size.ravel(), shape.width, leaf, rng,
        across=(tangent + rng.normal(0, 0.25, (n, k, 3))).reshape(-1, 3), spread=0.1,
    )  # fmt: skip
    return lift(join([rib_mesh, mesh]))


def fans(
    rng: np.random.Generator, root: ArrayLike, azimuth: ArrayLike, elevation: ArrayLike, stalk: ArrayLike,
    radius: float, leaf: Surface, *, segments: int = 13,
) -> Mesh:  # fmt: skip
    """Return palmate leaves on stalks: a pleated disc, cut into pointed segments whose tips hang.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of all that differs from leaf to leaf.
    root : array-like of shape (n, 3) or (3,)
        Where the stalks begin, metres.
    azimuth, elevation : array-like of shape (n,)
        First direction of each stalk, radians.
    stalk : array-like
        Length of each stalk, metres; broadcasts to (n,).
    radius : float
        Of the average leaf, metres.
    leaf : Surface
        The average leaf.
    segments : int, default 13
        Segments of a leaf.

    Returns
    -------
    Mesh
        ``12 + 2 segments`` faces per leaf.
    """
    a, e = np.asarray(azimuth, dtype=np.float64), np.asarray(elevation, dtype=np.float64)
    n = len(a)
    start = np.broadcast_to(np.asarray(root, dtype=np.float64), (n, 3))
    long = np.broadcast_to(np.asarray(stalk, dtype=np.float64), (n,))
    ribs = _ribs(start, a, e, long, np.full(n, 0.5), 3)
    stalks = tubes(ribs, 0.016, leaf, sides=3)
    hub, forward = ribs[:, -1], unit(ribs[:, -1] - ribs[:, -2])
    side = np.stack([-np.sin(a), np.cos(a), np.zeros(n)], 1)
    over = np.cross(forward, side)
    angle = np.linspace(-2.0, 2.0, segments + 1)
    r = (radius * rng.uniform(0.8, 1.15, (n, 1)))[..., None]
    spoke = np.cos(angle)[:, None] * forward[:, None] + np.sin(angle)[:, None] * side[:, None]
    pleat = 0.12 * np.where(np.arange(segments + 1) % 2, 1.0, -1.0)[:, None] * over[:, None]
    edge = hub[:, None] + 0.55 * r * (spoke + pleat - 0.08 * np.abs(np.sin(angle))[:, None] * _UP)
    hanging = 0.3 * r * rng.uniform(0.3, 1.2, (n, segments, 1)) * _UP
    tip = hub[:, None] + r * unit(spoke[:, 1:] + spoke[:, :-1]) - hanging
    centre = np.broadcast_to(hub[:, None], (n, segments, 3))
    inner = np.stack([centre, edge[:, :-1], edge[:, 1:]], axis=2)
    outer = np.stack([edge[:, 1:], edge[:, :-1], tip], axis=2)
    corners = np.concatenate([inner, outer], axis=1).reshape(-1, 3)
    mesh = Mesh(corners, np.arange(len(corners)).reshape(-1, 3), leaf.rows(len(corners) // 3))
    tone = np.repeat(rng.normal(1, 0.12, (n, 1)).clip(0.5, 1.5), 2 * segments, axis=0)
    mesh.attributes[:, RED:] = (mesh.attributes[:, RED:] * tone).clip(0.01, 0.98)
    return join([stalks, mesh])


def boots(rng: np.random.Generator, path: Floats, radii: Floats, count: int, size: float, bark: Surface) -> Mesh:
    """Return the stubs of old leaves that clothe a trunk, in a spiral.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of all that differs from stub to stub.
    path : ndarray of shape (m, 3), float64
        The trunk's axis, upwards, metres.
    radii : ndarray of shape (m,), float64
        Its radius at each point, metres.
    count : int
        How many stubs.
    size : float
        Length of a stub, metres.
    bark : Surface
        What they are made of.

    Returns
    -------
    Mesh
        One face per stub.
    """
    t = np.linspace(0.0, 1.0, count) * (len(path) - 1)
    place = np.column_stack([np.interp(t, np.arange(len(path)), path[:, k]) for k in range(3)])
    radius = np.interp(t, np.arange(len(path)), radii)
    azimuth = 2.39996 * np.arange(count) + rng.normal(0, 0.1, count)
    out = bearing(azimuth, np.zeros(count))
    tangential = bearing(azimuth + np.pi / 2, np.zeros(count))
    towards = out * rng.uniform(0.35, 0.9, (count, 1)) + _UP
    roots = place + 0.97 * radius[:, None] * out
    length = size * rng.uniform(0.6, 1.3, count)
    return blades(roots, towards, length, 0.9 * size, bark, rng, across=tangential)
