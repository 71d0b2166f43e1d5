"""Hedges."""

from __future__ import annotations

import numpy as np

from mlsroad_pipeline.simulation.model.batches import blades, lift, tubes
from mlsroad_pipeline.simulation.model.meshes import Mesh, join
from mlsroad_pipeline.simulation.plants.crowns import UNDERGROUND
from mlsroad_pipeline.simulation.plants.plant_materials import bark, foliage


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
