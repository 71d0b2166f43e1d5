"""Fronds of palms and cycads, and the trunks under them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mlsroad_pipeline.simulation.model.meshes import RED, Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import GOLDEN, Floats, bearing, blades, lift, tubes, unit

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Feather:
    """Shape of a feathered frond."""

    bend: float  # Angle between the first and the last direction of the rib, radians
    leaflets: int  # Leaflets on each side
    leaflet: float  # Length of the longest over that of the frond
    width: float  # Of a leaflet, metres
    lift: float = 0.0  # Angle of leaflets above the rib on both sides, like a keel, radians; negative ones hang
    plumes: float = 0.1  # Standard deviation of the leaflets' directions: large values make a plume, small ones a comb
    forward: float = 0.6  # Inclination of leaflets towards the tip
    bare: float = 0.12  # Share of the rib without leaflets


def _ribs(root: Floats, azimuth: Floats, elevation: Floats, length: Floats, bend: Floats, steps: int) -> Floats:
    """Return curves of given lengths that bend downwards along their way."""
    s = np.linspace(0, 1, steps)
    middle = (s[1:] + s[:-1]) / 2
    angle = elevation[:, None] - bend[:, None] * middle**1.4
    # Beyond the vertical a rib hangs straight down.
    angle = np.maximum(angle, -1.5)
    step = (length / (steps - 1))[:, None, None] * bearing(azimuth[:, None], angle)
    return root[:, None] + np.concatenate([np.zeros((len(root), 1, 3)), np.cumsum(step, axis=1)], axis=1)


def feathers(
    rng: np.random.Generator, root: ArrayLike, azimuth: ArrayLike, elevation: ArrayLike, length: ArrayLike,
    shape: Feather, leaf: Surface,
) -> Mesh:  # fmt: skip
    """Return fronds with a rib and leaflets on both sides, ``24 + 2 leaflets`` faces each.

    `root` is (n, 3) or (3,), metres; `azimuth` and `elevation` are the first direction of each rib, radians; the rib is
    paler than the average `leaf`.
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
    # Places of the leaflets of each frond: alternating, a little uneven.
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
    """Return palmate leaves on stalks: pleated discs of pointed segments with hanging tips.

    `root` is (n, 3) or (3,), metres; `azimuth` and `elevation` are the first direction of each stalk, radians; `radius`
    is that of the average leaf, metres. Each leaf has ``12 + 2 segments`` faces.
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
    """Return the stubs of old leaves on a trunk with the axis `path`, in a spiral, one face each."""
    t = np.linspace(0.0, 1.0, count) * (len(path) - 1)
    place = np.column_stack([np.interp(t, np.arange(len(path)), path[:, k]) for k in range(3)])
    radius = np.interp(t, np.arange(len(path)), radii)
    azimuth = GOLDEN * np.arange(count) + rng.normal(0, 0.1, count)
    out = bearing(azimuth, np.zeros(count))
    tangential = bearing(azimuth + np.pi / 2, np.zeros(count))
    towards = out * rng.uniform(0.35, 0.9, (count, 1)) + _UP
    roots = place + 0.97 * radius[:, None] * out
    length = size * rng.uniform(0.6, 1.3, count)
    return blades(roots, towards, length, 0.9 * size, bark, rng, across=tangential)
