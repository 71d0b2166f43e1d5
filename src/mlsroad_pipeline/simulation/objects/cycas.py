"""Cycads: a short, scaly stem under a rosette of stiff fronds, alone, with side shoots, or tall.

Measures follow horticultural handbooks of Cycas revoluta: fronds of 0.5 to 1.5 m, stems of 0.15 to 0.35 m across,
rarely above 2 m high.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from mlsroad_pipeline.simulation.model.batches import Floats, tubes
from mlsroad_pipeline.simulation.model.design import Design
from mlsroad_pipeline.simulation.model.meshes import Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import ellipsoid
from mlsroad_pipeline.simulation.plants.crowns import UNDERGROUND
from mlsroad_pipeline.simulation.plants.fronds import Feather, boots, feathers
from mlsroad_pipeline.simulation.plants.plant_materials import bark, foliage

_GOLDEN = 2.39996


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
    azimuth = _GOLDEN * np.arange(n) + rng.normal(0, 0.15, n)
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
    Design("sago_cycas", "cycas", partial(_single, stem=(0.1, 0.55), reach=(0.55, 1.2)), 1.4, 3.0),
    Design("tall_cycas", "cycas", partial(_single, stem=(0.6, 1.7), reach=(0.8, 1.35)), 1.5, 1.0),
    Design("cycas_family", "cycas", _family, 1.6, 1.0),
)
"""Every design of a cycad."""
