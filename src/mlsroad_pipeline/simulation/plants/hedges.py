"""Hedges."""

import numpy as np

from mlsroad_pipeline.simulation.model.materials import bark, foliage
from mlsroad_pipeline.simulation.model.meshes import Mesh, join
from mlsroad_pipeline.simulation.model.solids import blades, lift, tubes
from mlsroad_pipeline.simulation.plants.crowns import UNDERGROUND


def hedge(rng: np.random.Generator, length: float) -> Mesh:
    """Return a clipped hedge along x, centred, 0.7 to 1.9 m high: leaves around twigs; every face is `hedge`."""
    height, depth = rng.uniform(0.7, 1.9), rng.uniform(0.4, 0.8)
    leaf, wood = foliage(("green", "dark", "light")[int(rng.integers(3))], "hedge", rng), bark("brown", "hedge", rng)
    area = 2 * length * height + length * depth
    n = int(260 * area)
    place = rng.uniform(-1, 1, (n, 3))
    # Leaves are densest near the two faces and the top.
    pick = rng.random(n)
    place[:, 1] = np.where(pick < 0.75, np.sign(place[:, 1]) * (1 - 0.25 * rng.random(n) ** 2), place[:, 1])
    place[:, 2] = np.where(pick > 0.72, 1 - 0.2 * rng.random(n) ** 2, place[:, 2])
    centres = place * [length / 2, depth / 2, height / 2] + [0, 0, height / 2]
    centres[:, 2] += 0.04 * np.sin(centres[:, 0] * 2.1) * (centres[:, 2] / height)
    size = rng.uniform(0.09, 0.15) * rng.uniform(0.7, 1.3, n)
    x = np.arange(-length / 2 + 0.2, length / 2, 0.45)
    foot = np.column_stack([x, 0 * x, np.full_like(x, -UNDERGROUND)])
    top = np.column_stack([x + rng.normal(0, 0.08, len(x)), rng.normal(0, 0.08, len(x)), np.full_like(x, 0.8 * height)])
    stems = tubes(np.stack([foot, top], 1), np.array([0.02, 0.008]), wood, sides=4)
    direction = rng.normal(size=(n, 3))
    return join([lift(blades(centres, direction, size, 0.7 * size, leaf, rng), margin=0.05), stems])


def thicket(rng: np.random.Generator, length: float, *, height: float, depth: float) -> Mesh:
    """Return a run of untrimmed hedge along x, centred: an uneven top and bulging sides with shoots.

    `height` and `depth` are those of its average, metres; runs of one height join. Every face is `hedge`.
    """
    leaf = foliage(("green", "dark", "light", "olive")[int(rng.integers(4))], "hedge", rng)
    wood = bark("brown", "hedge", rng)
    n = int(min(260 * (2 * length * height + length * depth), 9000))
    x = rng.uniform(-length / 2, length / 2, n)
    waves = rng.uniform(0.8, 3.5, (2, 4)) * rng.choice([-1, 1], (2, 4))
    phase = rng.uniform(0, 6.28, (2, 4))
    # Both unevennesses vanish at the ends, so that runs of one height join.
    fade = np.minimum(1.0, (length / 2 - np.abs(x)) / 0.6)
    top = height * (1 + 0.13 * fade * np.sin(x[:, None] * waves[0] + phase[0]).sum(axis=1))
    z = top * rng.random(n) ** 0.8
    bulge = 1 + 0.16 * np.sin(x[:, None] * waves[1] + 2.2 * z[:, None] + phase[1]).sum(axis=1)
    half = 0.5 * depth * bulge * np.sqrt(np.clip(1.15 - (z / top) ** 3, 0.1, 1.0))
    aside = rng.choice([-1.0, 1.0], n) * (1 - 0.5 * rng.random(n) ** 2)
    crest = rng.random(n) < 0.2
    z = np.where(crest, top * (1 - 0.12 * rng.random(n)), z)
    y = np.where(crest, rng.uniform(-1, 1, n), aside) * half
    places = np.column_stack([x, y, z + 0.03]) + rng.normal(0, 0.05, (n, 3))
    shoots = max(int(2.5 * length), 1)
    along = np.linspace(0.0, 1.0, 14)
    foot = places[rng.integers(0, n, shoots)]
    tips = foot + np.column_stack([rng.normal(0, 0.12, shoots), 0.25 * np.sign(foot[:, 1]) * rng.random(shoots),
                                   rng.uniform(0.15, 0.7, shoots)])  # fmt: skip
    grown = (foot[:, None] + along[:, None] * (tips - foot)[:, None]).reshape(-1, 3)
    places = np.concatenate([places, grown + rng.normal(0, 0.025, grown.shape)])
    places[:, 2] = np.maximum(places[:, 2], 0.03)
    size = rng.uniform(0.13, 0.2) * rng.uniform(0.7, 1.4, len(places))
    direction = rng.normal(size=(len(places), 3)) + np.array([0, 0, 0.3])
    at = np.arange(-length / 2 + 0.2, length / 2, 0.6)
    root = np.column_stack([at, 0 * at, np.full_like(at, -UNDERGROUND)])
    head = np.column_stack([at, rng.normal(0, 0.15 * depth, len(at)), np.full_like(at, 0.75 * height)])
    stems = tubes(np.stack([root, head], 1), np.array([0.03, 0.01]), wood, sides=4)
    return join([lift(blades(places, direction, size, 0.7 * size, leaf, rng), margin=0.05), stems])
