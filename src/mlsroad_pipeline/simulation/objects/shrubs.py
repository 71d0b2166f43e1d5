"""Brushwood: loose and flowering bushes, clipped shapes, ground cover, tufts of grass and rosettes of stiff leaves.

Measures follow planting lists: bushes of 0.6 to 2.2 m, clipped ones of 0.5 to 1.5 m, ground cover below 0.5 m.
"""

from functools import partial

import numpy as np

from mlsroad_pipeline.simulation.model.materials import bark, foliage
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh, join
from mlsroad_pipeline.simulation.model.solids import GOLDEN, Floats, bearing, blades, bows, lift, tubes, unit
from mlsroad_pipeline.simulation.plants.crowns import UNDERGROUND, Outline

_LEAVES = ("green", "dark", "light", "olive", "copper", "yellow")
_WEIGHTS = (0.45, 0.2, 0.15, 0.1, 0.05, 0.05)


def _leaf_name(rng: np.random.Generator) -> str:
    return _LEAVES[int(rng.choice(len(_LEAVES), p=_WEIGHTS))]


def _stems(rng: np.random.Generator, tips: Floats, radius: float) -> Mesh:
    """Return stems that rise from one root and bend over to end points."""
    n = len(tips)
    foot = np.column_stack([0.15 * tips[:, :2], np.full(n, -UNDERGROUND)])
    paths = bows(foot, unit(np.array([0, 0, 1.0]) + rng.normal(0, 0.15, (n, 3))), tips, 4)
    thick = radius * rng.uniform(0.6, 1.2, (n, 1)) * np.array([1.0, 0.8, 0.55, 0.25])
    return tubes(paths, thick, bark(("brown", "grey")[int(rng.integers(2))], "brushwood", rng), sides=4)


def _bush(rng: np.random.Generator, *, flowers: bool = False) -> Mesh:
    """Return a loose bush of several lobes; in flower, some of its leaves are petals at the outside."""
    height, width = rng.uniform(0.6, 2.1), rng.uniform(0.7, 2.2)
    n_lobes = int(rng.integers(2, 6))
    stretch = np.array([1.0, rng.uniform(0.6, 1.0), 1.0])
    azimuth = rng.uniform(0, 6.28) + np.arange(n_lobes) * 6.28 / n_lobes + rng.normal(0, 0.3, n_lobes)
    away = 0.25 * width * rng.uniform(0.4, 1.0, n_lobes) * (n_lobes > 1)
    n = int(rng.integers(1500, 1950))
    which = rng.integers(0, n_lobes, n)
    places = np.empty((n, 3))
    volume = 0.0
    for k in range(n_lobes):
        mine = which == k
        top, m = height * rng.uniform(0.65, 1.0), int(mine.sum())
        lobe = Outline(rng, 0.04, top, 0.27 * width * rng.uniform(0.8, 1.2), (0.45, 0.7))
        depth = rng.random(m) ** (1 / rng.uniform(2.5, 5.0))
        places[mine] = lobe.place(rng.random(m), rng.uniform(0, 6.28, m), depth)
        volume += lobe.volume
    places = (places + away[which, None] * bearing(azimuth, np.zeros(n_lobes))[which]) * stretch
    places += rng.normal(0, 0.03, places.shape)
    size = float(np.clip(np.sqrt(2 * rng.uniform(2.2, 4.0) * volume / n / 0.6), 0.05, 0.16)) * rng.uniform(
        0.65, 1.35, n
    )
    leaf = foliage(_leaf_name(rng), "brushwood", rng)
    meshes = [_stems(rng, places[:: max(n // 12, 1)], 0.014)]
    direction = rng.normal(size=(n, 3)) + np.array([0, 0, 0.3])
    meshes.append(lift(blades(places, direction, size, 0.6 * size, leaf, rng)))
    if flowers:
        petals = foliage(("pink", "white", "purple", "red", "yellow")[int(rng.integers(5))], "brushwood", rng)
        middle = places.mean(axis=0)
        outer = places[((places - middle) ** 2).sum(axis=1).argsort()[-n // 2 :]]
        outer = outer[rng.permutation(len(outer))[: int(rng.integers(90, 260))]]
        outer = outer + 0.04 * unit(outer - middle) + rng.normal(0, 0.02, outer.shape)
        bloom = rng.uniform(0.03, 0.075)
        meshes.append(lift(blades(outer, rng.normal(size=outer.shape), bloom, bloom, petals, rng)))
    return join(meshes)


def _shell(rng: np.random.Generator, places: Floats, normals: Floats, area: float, leaf: str) -> Mesh:
    """Return the small leaves of a clipped surface, mostly tangential to it."""
    n = len(places)
    direction = rng.normal(0, 0.6, (n, 3)) + rng.uniform(0.2, 0.8, (n, 1)) * normals
    size = float(np.clip(np.sqrt(2 * 2.2 * area / n / 0.7), 0.035, 0.14)) * rng.uniform(0.7, 1.3, n)
    roots = places - 0.4 * size[:, None] * unit(direction)
    return lift(blades(roots, direction, size, 0.7 * size, foliage(leaf, "brushwood", rng), rng), margin=0.05)


def _ball(rng: np.random.Generator) -> Mesh:
    """Return a clipped ball, its lowest part in the ground."""
    radii = rng.uniform(0.3, 0.75) * np.array([1.0, rng.uniform(0.9, 1.1), rng.uniform(0.8, 1.1)])
    centre = np.array([0.0, 0.0, radii[2] * rng.uniform(0.75, 1.0)])
    n = 2150
    sphere = unit(rng.normal(size=(n, 3)))
    dents = 1 + 0.04 * np.cos(3 * sphere @ rng.normal(0, 1, 3) + rng.uniform(0, 6.28))
    depth = np.where(rng.random(n) < 0.75, rng.uniform(0.93, 1.0, n), rng.uniform(0.6, 0.95, n))
    places = centre + radii * sphere * (depth * dents)[:, None]
    area = 4 * np.pi * float((radii**1.6).mean()) ** (2 / 1.6)
    tips = places[::200] * [0.8, 0.8, 0.9]
    keep = places[:, 2] > 0.01
    return join([_stems(rng, tips, 0.012), _shell(rng, places[keep], sphere[keep], area, _leaf_name(rng))])


def _clipped(rng: np.random.Generator) -> Mesh:
    """Return a clipped block or pyramid with rounded edges."""
    half = rng.uniform([0.3, 0.25, 0.3], [0.9, 0.5, 0.65])
    taper = rng.uniform(0.15, 0.35) if rng.random() < 0.35 else rng.uniform(0.85, 1.0)
    n = 2150
    area_of = np.array([half[1] * half[2], half[0] * half[2], half[0] * half[1]])
    axis = rng.choice(3, n, p=area_of / area_of.sum())
    places = rng.uniform(-1, 1, (n, 3))
    sign = np.where(axis == 2, 1.0, rng.choice([-1.0, 1.0], n))
    inner = np.where(rng.random(n) < 0.75, 1.0, rng.uniform(0.7, 1.0, n))
    places[np.arange(n), axis] = sign * inner
    normals = np.eye(3)[axis] * sign[:, None]
    share = (places[:, 2:] + 1) / 2
    places[:, :2] *= 1 + (taper - 1) * share
    places *= 1 - 0.035 * (places**4).sum(axis=1, keepdims=True).clip(0, 2)
    places = places * half + [0, 0, half[2]]
    tips = places[::220] * [0.8, 0.8, 0.9]
    area = 8 * float(area_of.sum()) - 4 * half[0] * half[1]
    return join([_stems(rng, tips, 0.012), _shell(rng, places, normals, area, _leaf_name(rng))])


def _ground_cover(rng: np.random.Generator) -> Mesh:
    """Return a low carpet of leaves with an uneven edge."""
    height, radius = rng.uniform(0.12, 0.42), rng.uniform(0.45, 1.1)
    n = int(rng.integers(1700, 2150))
    azimuth, share = rng.uniform(0, 6.28, n), np.sqrt(rng.random(n))
    waves = np.arange(2, 6)
    lobe = 1 + np.cos(waves * azimuth[:, None] + rng.uniform(0, 6.28, 4)) @ rng.normal(0, 0.08, 4)
    xy = (radius * share * lobe)[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    top = height * (1 - share**4) * (0.75 + 0.25 * np.cos(xy @ rng.normal(0, 4, 2) + rng.uniform(0, 6.28)))
    places = np.column_stack([xy, 0.02 + top * rng.uniform(0.3, 1.0, n) ** 0.5])
    size = float(np.clip(np.sqrt(2 * 2.5 * np.pi * radius**2 / n / 0.7), 0.04, 0.13)) * rng.uniform(0.7, 1.3, n)
    direction = rng.normal(0, 0.7, (n, 3)) + np.array([0, 0, 0.5])
    leaf = foliage(_leaf_name(rng), "brushwood", rng)
    tips = places[:: n // 10] * [0.6, 0.6, 0.8]
    return join([_stems(rng, tips, 0.006), lift(blades(places, direction, size, 0.7 * size, leaf, rng), margin=0.05)])


def _tuft(rng: np.random.Generator) -> Mesh:
    """Return a tuft of long grass: blades from one root that bow outwards, some with ears."""
    height, spread = rng.uniform(0.45, 1.6), rng.uniform(0.25, 0.75)
    n = int(rng.integers(700, 1000))
    azimuth, lean = rng.uniform(0, 6.28, n), spread * np.sqrt(rng.random(n))
    foot = bearing(azimuth, np.zeros(n)) * (rng.uniform(0.03, 0.16) * rng.random(n) ** 0.5)[:, None]
    length = height * rng.uniform(0.55, 1.0, n)
    aside = bearing(azimuth + np.pi / 2, np.zeros(n)) + rng.normal(0, 0.3, (n, 3))
    first = bearing(azimuth, np.pi / 2 - lean)
    foot[:, 2] = -0.03
    leaf = foliage(("straw", "olive", "light", "green", "copper")[int(rng.integers(5))], "brushwood", rng)
    lower = blades(foot, first, 0.75 * length, 0.012 + 0.006 * height, leaf, rng, across=aside)
    knee = foot + 0.55 * length[:, None] * first
    second = bearing(azimuth, np.pi / 2 - 2.2 * lean - rng.uniform(0.1, 0.5, n))
    upper = lift(blades(knee, second, 0.45 * length, 0.01, leaf, rng, across=aside))
    meshes = [lower, upper]
    if rng.random() < 0.5:
        few = rng.integers(0, n, int(rng.integers(15, 45)))
        stalks = bearing(azimuth[few], np.pi / 2 - rng.uniform(0.2, 0.9, len(few)) * lean[few])
        tall = height * rng.uniform(0.75, 1.05, len(few))
        ear = foot[few] + (0.9 * tall)[:, None] * stalks
        meshes += [blades(foot[few], stalks, tall, 0.01, leaf, rng)]
        meshes += [blades(ear, stalks, 0.2 * height, 0.022 * height, foliage("straw", "brushwood", rng), rng)]
    return join(meshes)


def _rosette(rng: np.random.Generator) -> Mesh:
    """Return a rosette of thick, pointed leaves, like those of agaves and yuccas."""
    n, reach = int(rng.integers(28, 60)), rng.uniform(0.4, 1.1)
    stem = rng.uniform(0.03, 0.5) if rng.random() < 0.4 else 0.03
    azimuth = GOLDEN * np.arange(n)
    elevation = 0.1 + 1.3 * (np.arange(n) / n) ** 0.9 + rng.normal(0, 0.06, n)
    root = np.array([0.0, 0.0, stem + 0.04])
    across = bearing(azimuth + np.pi / 2, np.zeros(n))
    length = reach * rng.uniform(0.8, 1.1, n)
    out = bearing(azimuth, elevation)
    wide = rng.uniform(0.05, 0.13) * (0.5 + reach)
    leaf = foliage(("blue", "green", "olive")[int(rng.integers(3))], "brushwood", rng)
    # Two halves meet in a keel below the leaf's middle.
    keel = np.cross(out, across) * (0.2 * wide)
    halves = [blades(root + 0.05 * out + k * 0.25 * wide * across, out - k * 0.12 * wide / reach * across, length,
                     0.5 * wide, leaf, rng, across=across - k * keel, spread=0.06) for k in (-1.0, 1.0)]  # fmt: skip
    path = np.array([[0, 0, -UNDERGROUND], [0, 0, 0.5 * stem], [0, 0, stem + 0.06]])
    trunk = tubes(path[None], np.array([[1.0, 1.1, 0.8]]) * 0.5 * wide, bark("palm", "brushwood", rng), sides=7)
    return join([trunk, *(lift(h) for h in halves)])


DESIGNS: tuple[Design, ...] = (
    Design("loose_bush", "brushwood", _bush, 1.4, 3.0),
    Design("flowering_bush", "brushwood", partial(_bush, flowers=True), 1.4, 1.5),
    Design("clipped_ball", "brushwood", _ball, 0.9, 1.5),
    Design("clipped_block", "brushwood", _clipped, 1.0, 1.0),
    Design("ground_cover", "brushwood", _ground_cover, 1.6, 1.0),
    Design("grass_tuft", "brushwood", _tuft, 1.4, 0.8),
    Design("leaf_rosette", "brushwood", _rosette, 1.2, 0.6),
)
