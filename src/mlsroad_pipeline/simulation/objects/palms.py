"""Palms: royal, date, pygmy date, fan, coconut, in clumps, young ones without a trunk; cycads: a rosette on a stem.

Measures follow horticultural handbooks: royal palms 6 to 16 m with trunks of 0.35 to 0.6 m, Canary date palms 3 to 10 m
on 0.5 to 0.9 m, Washingtonias 5 to 16 m on 0.3 to 0.6 m, coconuts 5 to 12 m on 0.2 to 0.32 m; fronds of 2 to 4.5 m.
Cycas revoluta has fronds of 0.5 to 1.5 m on stems of 0.15 to 0.35 m across, rarely above 2 m high.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from mlsroad_pipeline.simulation.model.materials import bark, foliage
from mlsroad_pipeline.simulation.model.meshes import DIFFUSE, Design, Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import GOLDEN, Floats, ellipsoid, scatter, tubes
from mlsroad_pipeline.simulation.plants.crowns import UNDERGROUND
from mlsroad_pipeline.simulation.plants.fronds import Feather, boots, fans, feathers


def _trunk(
    rng: np.random.Generator, height: float, radius: float, *, lean: float, swell: float, belly: float = 0.0,
    rings: int = 24,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return the axis and the radii of a trunk with rings; it may lean, then rise again."""
    s = np.linspace(0, 1, rings)
    azimuth, curve = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 1.0)
    out = lean * height * (s + curve * s * (1 - s)) + 0.01 * height * np.sin(2 * np.pi * s * rng.uniform(0.6, 1.6))
    z = -UNDERGROUND + s * (height + UNDERGROUND)
    path = np.column_stack([out * np.cos(azimuth), out * np.sin(azimuth), z])
    foot = np.interp(0.0, z, out)
    path[:, :2] -= foot * np.array([np.cos(azimuth), np.sin(azimuth)])
    shape = 1 + swell * np.exp(-s * height / 0.5) + belly * np.exp(-(((s - 0.45) / 0.22) ** 2)) - 0.2 * s
    shape += 0.035 * np.where(np.arange(rings) % 2, 1, -1) + rng.normal(0, 0.01, rings)
    return path, radius * shape


def _crown(rng: np.random.Generator, n: int, low: float, high: float) -> tuple[Floats, Floats]:
    """Return azimuths and elevations of fronds, the youngest ones upright."""
    age = (np.arange(n) + rng.uniform(0, 1, n)) / n
    azimuth = GOLDEN * np.arange(n) + rng.normal(0, 0.2, n)
    return azimuth, high - (high - low) * age**0.8 + rng.normal(0, 0.06, n)


def _dead(rng: np.random.Generator, top: Floats, length: float, most: int, shape: Feather) -> list[Mesh]:
    n = int(rng.integers(0, most + 1))
    if n == 0:
        return []
    azimuth, elevation = rng.uniform(0, 6.28, n), rng.uniform(-1.3, -0.8, n)
    dry = foliage("dry", "palm", rng)
    return [feathers(rng, top, azimuth, elevation, length * rng.uniform(0.5, 0.85, n), shape, dry)]


def _royal(rng: np.random.Generator) -> Mesh:
    """Return a royal palm: a pale, bellied trunk, a smooth green shaft and plumes."""
    height, radius = rng.uniform(4.5, 12.0), rng.uniform(0.16, 0.28)
    path, radii = _trunk(rng, height, radius, lean=rng.normal(0, 0.012), swell=rng.uniform(0.2, 0.5),
                         belly=rng.uniform(0, 0.25))  # fmt: skip
    leaf = foliage("green", "palm", rng)
    meshes = [tubes(path[None], radii[None], bark("smooth_palm", "palm", rng), sides=10)]
    shaft = rng.uniform(0.8, 1.7)
    steps = np.linspace(0, 1, 5)
    axis = path[-1] + np.column_stack([0 * steps, 0 * steps, shaft * steps])
    green = Surface(leaf.label, (leaf.rgb[0] * 1.2, leaf.rgb[1] * 1.2, leaf.rgb[2]), leaf.reflectivity, DIFFUSE)
    meshes.append(tubes(axis[None], (radii[-1] * np.array([1.05, 1.1, 0.9, 0.6, 0.35]))[None], green, sides=9))
    n = int(rng.integers(13, 20))
    azimuth, elevation = _crown(rng, n, -0.25, 1.3)
    shape = Feather(rng.uniform(1.0, 1.6), 48, 0.23, 0.075, plumes=0.4, forward=0.5)
    length = rng.uniform(2.6, 4.2) * rng.uniform(0.85, 1.1, n)
    meshes.append(feathers(rng, axis[-2], azimuth, elevation, length, shape, leaf))
    return join([*meshes, *_dead(rng, axis[0], float(length.mean()), 2, shape)])


@dataclass(frozen=True)
class _Date:
    """Ranges of a kind of date palm, metres; see `_date`."""

    height: tuple[float, float]
    radius: tuple[float, float]
    frond: tuple[float, float]
    fronds: tuple[int, int]
    leaflets: int
    width: float


def _date(rng: np.random.Generator, *, kind: _Date) -> Mesh:
    """Return a date palm: a stout trunk covered in stubs under a globe of stiff fronds."""
    height, radius = rng.uniform(*kind.height), rng.uniform(*kind.radius)
    path, radii = _trunk(rng, height, radius, lean=rng.normal(0, 0.02), swell=rng.uniform(0.0, 0.3), rings=16)
    radii[-4:] *= np.array([1.05, 1.2, 1.3, 1.1])
    wood = bark("palm", "palm", rng)
    stubs = boots(rng, path[1:], radii[1:], int(40 + 60 * min(height, 6.0)), 0.75 * radius, wood)
    meshes = [tubes(path[None], radii[None], wood, sides=9), stubs]
    n = int(rng.integers(*kind.fronds))
    azimuth, elevation = _crown(rng, n, rng.uniform(-0.7, -0.35) if height > kind.frond[1] else 0.3, 1.4)
    shape = Feather(
        rng.uniform(0.7, 1.15), kind.leaflets, 0.15, kind.width, lift=0.45, plumes=0.12, forward=0.9, bare=0.08
    )
    length = rng.uniform(*kind.frond) * rng.uniform(0.85, 1.1, n)
    leaf = foliage(("green", "olive", "blue")[int(rng.integers(3))], "palm", rng)
    meshes.append(feathers(rng, path[-1], azimuth, elevation, length, shape, leaf))
    return join([*meshes, *_dead(rng, path[-1], float(length.mean()), 5, shape)])


def _fan(rng: np.random.Generator) -> Mesh:
    """Return a fan palm: a slender trunk, pleated leaves, and a skirt of dead ones."""
    height, radius = rng.uniform(4.0, 14.0), rng.uniform(0.14, 0.28)
    path, radii = _trunk(rng, height, radius, lean=rng.normal(0, 0.02), swell=rng.uniform(0.4, 0.9), rings=20)
    wood = bark("palm", "palm", rng)
    meshes = [tubes(path[None], radii[None], wood, sides=9)]
    if rng.random() < 0.5:
        meshes.append(boots(rng, path[8:], radii[8:], 90, 0.22, wood))
    n, blade = int(rng.integers(28, 46)), rng.uniform(0.6, 0.95)
    azimuth, elevation = _crown(rng, n, -0.5, 1.35)
    leaf = foliage(("green", "light", "blue")[int(rng.integers(3))], "palm", rng)
    stalk = rng.uniform(0.8, 1.4) * rng.uniform(0.85, 1.15, n)
    meshes.append(fans(rng, path[-1], azimuth, elevation, stalk, blade, leaf))
    skirt = rng.uniform(0.0, 0.45 * min(height, 6.0)) if rng.random() < 0.7 else 0.0
    m = int(24 * skirt)
    if m > 0:
        z = height - skirt * rng.random(m)
        at = np.column_stack([np.interp(z, path[:, 2], path[:, k]) for k in range(2)] + [z])
        dry = foliage("dry", "palm", rng)
        meshes.append(fans(rng, at, rng.uniform(0, 6.28, m), rng.uniform(-1.35, -0.9, m), 0.5, blade, dry))
    return join(meshes)


def _coconut(rng: np.random.Generator) -> Mesh:
    """Return a coconut palm: a thin trunk that leans and rises again, long drooping fronds, nuts."""
    height, radius = rng.uniform(4.5, 11.0), rng.uniform(0.1, 0.16)
    lean = rng.uniform(0.08, 0.35)
    path, radii = _trunk(rng, height, radius, lean=lean, swell=rng.uniform(0.5, 1.1))
    meshes = [tubes(path[None], radii[None], bark("smooth_palm", "palm", rng), sides=9)]
    n = int(rng.integers(18, 27))
    azimuth, elevation = _crown(rng, n, -0.55, 1.25)
    shape = Feather(rng.uniform(1.1, 1.7), 44, 0.19, 0.05, lift=-0.5, plumes=0.12, forward=0.45, bare=0.18)
    length = rng.uniform(2.8, 4.4) * rng.uniform(0.85, 1.1, n)
    meshes.append(feathers(rng, path[-1], azimuth, elevation, length, shape, foliage("green", "palm", rng)))
    husk = foliage(("yellow", "green", "dry")[int(rng.integers(3))], "palm", rng)
    husk = Surface(husk.label, husk.rgb, husk.reflectivity, DIFFUSE)
    for place in scatter(rng, int(rng.integers(0, 10)), shell=9) * 0.26:
        meshes.append(ellipsoid(path[-1] + place - [0, 0, 0.22], [0.1, 0.1, 0.13], husk, rings=3, sides=6))
    return join([*meshes, *_dead(rng, path[-1], float(length.mean()), 4, shape)])


def _clump(rng: np.random.Generator) -> Mesh:
    """Return a clump of thin palms from one root."""
    n = int(rng.integers(4, 9))
    leaf, wood = foliage("light", "palm", rng), bark("smooth_palm", "palm", rng)
    heights = rng.uniform(0.8, 3.2, n)
    azimuth = GOLDEN * np.arange(n) + rng.normal(0, 0.3, n)
    out = rng.uniform(0.08, 0.4, n)
    s = np.linspace(0, 1, 8)[None, :, None]
    aside = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(n)])
    foot = out[:, None] * aside - [0, 0, UNDERGROUND]
    top = (out + 0.22 * heights)[:, None] * aside + heights[:, None] * [0, 0, 1]
    paths = (1 - s) * foot[:, None] + s * top[:, None] - 0.15 * (s * (1 - s)) * aside[:, None]
    ringed = rng.uniform(0.03, 0.055) * (1 + 0.06 * (np.arange(8) % 2))
    meshes = [tubes(paths, ringed, wood, sides=6)]
    per = 6
    elevation = np.tile(np.linspace(0.25, 1.35, per), n) + rng.normal(0, 0.1, n * per)
    turn = np.repeat(azimuth, per) + np.tile(GOLDEN * np.arange(per), n) + rng.normal(0, 0.3, n * per)
    shape = Feather(rng.uniform(0.9, 1.5), 18, 0.24, 0.045, lift=0.4, plumes=0.12)
    length = rng.uniform(1.3, 2.1) * rng.uniform(0.8, 1.15, n * per)
    return join([*meshes, feathers(rng, np.repeat(top, per, axis=0), turn, elevation, length, shape, leaf)])


def _young(rng: np.random.Generator) -> Mesh:
    """Return a young palm without a trunk; its fronds start at the ground."""
    stem, n = rng.uniform(0.05, 0.5), int(rng.integers(11, 22))
    path = np.array([[0, 0, -UNDERGROUND], [0, 0, 0.4 * stem], [0, 0, stem]])
    wood = bark("palm", "palm", rng)
    meshes = [tubes(path[None], np.array([[1.0, 1.15, 0.7]]) * rng.uniform(0.08, 0.2), wood, sides=8)]
    azimuth, elevation = _crown(rng, n, 0.35, 1.4)
    shape = Feather(rng.uniform(0.8, 1.5), 30, 0.2, 0.045, lift=0.3, plumes=0.15)
    length = rng.uniform(1.1, 2.3) * rng.uniform(0.8, 1.1, n)
    return join([*meshes, feathers(rng, path[-1], azimuth, elevation, length, shape, foliage("green", "palm", rng))])


_CANARY = _Date((3.0, 8.5), (0.24, 0.42), (2.6, 4.0), (52, 72), 22, 0.07)
_PYGMY = _Date((1.2, 2.6), (0.07, 0.12), (0.9, 1.5), (32, 50), 18, 0.035)


def _head(
    rng: np.random.Generator, foot: Floats, top: Floats, radius: float, n: int, reach: float, leaflets: int,
    colours: tuple[Surface, Surface],
) -> list[Mesh]:  # fmt: skip
    """Return one stem with its rosette."""
    wood, leaf = colours
    s = np.linspace(0, 1, 5)[:, None]
    path = (1 - s) * foot + s * top
    radii = radius * np.array([1.1, 1.15, 1.05, 1.0, 0.6])
    size = float(np.linalg.norm(top - foot))
    meshes = [tubes(path[None], radii[None], wood, sides=8), boots(rng, path, radii, int(30 + 60 * size), 0.07, wood)]
    azimuth = GOLDEN * np.arange(n) + rng.normal(0, 0.15, n)
    low = rng.uniform(-0.15, 0.25)
    elevation = low + (1.35 - low) * (np.arange(n) / n) ** 1.2 + rng.normal(0, 0.07, n)
    shape = Feather(rng.uniform(0.5, 1.1), leaflets, 0.15, 0.022, lift=0.5, plumes=0.06, forward=0.5, bare=0.16)
    length = reach * rng.uniform(0.85, 1.1, n)
    meshes.append(feathers(rng, top, azimuth, elevation, length, shape, leaf))
    return meshes


def _colours(rng: np.random.Generator) -> tuple[Surface, Surface]:
    return bark("palm", "cycas", rng), foliage(("dark", "green", "olive")[int(rng.integers(3))], "cycas", rng)


def _single(rng: np.random.Generator, *, stem: tuple[float, float], reach: tuple[float, float]) -> Mesh:
    """Return one rosette on a stem; some have a seed cone in the middle."""
    height, colours = rng.uniform(*stem), _colours(rng)
    top = np.array([*rng.normal(0, 0.06 * height, 2), height])
    foot = np.array([0.0, 0.0, -UNDERGROUND])
    n = int(rng.integers(22, 38))
    meshes = _head(rng, foot, top, rng.uniform(0.09, 0.18), n, rng.uniform(*reach), 17, colours)
    if rng.random() < 0.25:
        dry = foliage("yellow", "cycas", rng)
        meshes.append(ellipsoid(top + np.array([0, 0, 0.12]), [0.11, 0.11, 0.15], dry, rings=4, sides=7))
    return join(meshes)


def _family(rng: np.random.Generator) -> Mesh:
    """Return an old plant with side shoots, each with its own rosette."""
    colours, reach = _colours(rng), rng.uniform(0.55, 0.95)
    n = int(rng.integers(2, 5))
    azimuth = rng.uniform(0, 6.28) + np.arange(n) * 2 * np.pi / n
    meshes = []
    for k in range(n):
        out = rng.uniform(0.15, 0.4) * (k > 0)
        foot = np.array([out * np.cos(azimuth[k]), out * np.sin(azimuth[k]), -UNDERGROUND])
        top = foot * [1.5, 1.5, 0] + [0, 0, rng.uniform(0.25, 0.7) if k == 0 else rng.uniform(0.08, 0.4)]
        size = reach * (1.0 if k == 0 else rng.uniform(0.5, 0.85))
        meshes += _head(rng, foot, top, rng.uniform(0.06, 0.11), 14 if n < 4 else 11, size, 11, colours)
    return join(meshes)


DESIGNS: tuple[Design, ...] = (
    Design("royal_palm", "palm", _royal, 0.7, 2.0),
    Design("date_palm", "palm", partial(_date, kind=_CANARY), 1.0, 1.5),
    Design("pygmy_date_palm", "palm", partial(_date, kind=_PYGMY), 1.0, 1.0),
    Design("fan_palm", "palm", _fan, 0.8, 1.5),
    Design("coconut_palm", "palm", _coconut, 1.2, 1.2),
    Design("clump_palm", "palm", _clump, 2.4, 0.8),
    Design("young_palm", "palm", _young, 2.4, 0.6),
    Design("sago_cycas", "cycas", partial(_single, stem=(0.1, 0.55), reach=(0.55, 1.2)), 1.4, 3.0),
    Design("tall_cycas", "cycas", partial(_single, stem=(0.6, 1.7), reach=(0.8, 1.35)), 1.5, 1.0),
    Design("cycas_family", "cycas", _family, 1.6, 1.0),
)
