"""Masts, arms and luminaires of several families of poles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from mlsroad_pipeline.simulation.model.materials import material
from mlsroad_pipeline.simulation.model.meshes import Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, ellipsoid, tube
from mlsroad_pipeline.simulation.objects.parts import UNDERGROUND, lathe, loft, tinted


def metal(label: str, rng: np.random.Generator) -> Surface:
    """Return the surface of a mast: galvanised, painted, or weathered aluminium."""
    return material(str(rng.choice(["galvanised", "painted_metal", "aluminium"], p=[0.45, 0.4, 0.15])), label, rng)


def mast(rng: np.random.Generator, height: float, radius: float, surface: Surface) -> Mesh:
    """Return an upright mast, from below ground, with a foot: conical or stepped, round to square."""
    sides = int(rng.choice([6, 8, 10, 12], p=[0.1, 0.3, 0.4, 0.2]))
    top = radius * rng.uniform(0.5, 0.9)
    step = rng.uniform(0.9, 2.2)
    if rng.random() < 0.35 and height > 2 * step:  # a wide lower part with the door
        neck = radius * rng.uniform(0.6, 0.75)
        profile = [[radius, -UNDERGROUND], [radius, step], [neck, step + 0.12], [min(top, neck), height], [0, height]]
    else:
        profile = [[radius, -UNDERGROUND], [radius, 0.4], [top, height], [0, height + 0.3 * top]]
    parts = [lathe(profile, surface, sides=sides)]
    foot = rng.random()
    if foot < 0.4:  # flange with anchor bolts
        width = radius * rng.uniform(3.4, 4.6)
        thick = rng.uniform(0.015, 0.04)
        parts.append(box([width, width, thick + 0.1], [0, 0, thick / 2 - 0.05], surface))
        for sx in (-1, 1):
            for sy in (-1, 1):
                at = 0.38 * width * np.array([sx, sy])
                parts.append(box([0.03, 0.03, 0.05], [at[0], at[1], thick + 0.025], surface))
    elif foot < 0.55:  # block of concrete
        wide, tall = radius * rng.uniform(4.0, 5.5), rng.uniform(0.06, 0.3)
        block = replace(tinted((0.42, 0.40, 0.37), "light_pole", 0.38, rng), label=surface.label)
        middle = (tall - UNDERGROUND) / 2
        parts.append(box([wide, wide, tall + UNDERGROUND], [0, 0, middle], block, taper=rng.uniform(0.8, 1.0)))
    elif foot < 0.8:  # door or fuse box
        low, tall = rng.uniform(0.35, 0.7), rng.uniform(0.25, 0.45)
        parts.append(box([0.03, radius, tall], [-radius, 0, low + tall / 2], surface))
    return join(parts)


def arm(start: ArrayLike, reach: float, rise: float, bend: float, surface: Surface, radius: float) -> Mesh:
    """Return an arm along +x that leaves its mast steeply and ends flat.

    `reach` and `rise` are the place of its end from its `start`, metres; `bend` is 0 for a straight arm and 1 for a
    quarter of an ellipse; `radius` is that at its beginning.
    """
    f = np.linspace(0, 1, 7 if bend > 0.05 else 2)
    lift = (1 - bend) * f + bend * np.sqrt(np.maximum(1 - (1 - f) ** 2, 0))
    path = np.asarray(start, dtype=np.float64) + np.column_stack([reach * f, 0 * f, rise * lift])
    return tube(path, np.linspace(radius, 0.7 * radius, len(f)), surface, sides=6)


def luminaire(rng: np.random.Generator, at: ArrayLike, surface: Surface, *, pitch: float = 0.0) -> Mesh:
    """Return the head of a street lamp at the end of an arm along +x, 0.4 to 0.95 m long.

    It is a cobra head, a flat panel or a drop lens, tilted upwards by `pitch`, radians.
    """
    length, width = rng.uniform(0.45, 0.9), rng.uniform(0.18, 0.36)
    lens = tinted((0.6, 0.6, 0.56), "light_pole", 0.45, rng)
    kind = int(rng.integers(3))
    if kind == 0:  # cobra head: slim at the arm, bulging below
        thick = rng.uniform(0.1, 0.17)
        f = np.array([0.0, 0.12, 0.4, 0.75, 0.95, 1.0])
        wide = width * np.array([0.25, 0.4, 0.95, 1.0, 0.75, 0.45])
        tall = thick * np.array([0.5, 0.7, 1.0, 0.95, 0.6, 0.3])
        turn = np.arange(8) * np.pi / 4
        sections = np.stack(
            [np.column_stack([np.full(8, length * x), w / 2 * np.cos(turn), t / 2 * np.sin(turn)])
             for x, w, t in zip(f, wide, tall, strict=True)]
        )  # fmt: skip
        parts = [loft(sections, surface), ellipsoid([0.62 * length, 0, -0.4 * thick], [0.3 * length, 0.4 * width,
                 rng.uniform(0.03, 0.1)], lens, rings=2, sides=6)]  # fmt: skip
    elif kind == 1:  # flat panel of diodes
        thick = rng.uniform(0.05, 0.09)
        parts = [box([length, width, thick], [length / 2, 0, 0], surface, taper=0.9),
                 box([0.7 * length, 0.8 * width, 0.02], [0.55 * length, 0, -thick / 2 - 0.005], lens)]  # fmt: skip
    else:  # bell with a drop lens
        r = width * rng.uniform(0.7, 1.0)
        bell = [[0.2 * r, 0.12], [0.45 * r, 0.08], [r, -0.05]]
        parts = [lathe(bell, surface, at=[r, 0, 0], sides=10),
                 ellipsoid([r, 0, -0.05], [0.8 * r, 0.8 * r, 0.5 * r], lens, rings=3, sides=8),
                 tube([[0, 0, 0.05], [r, 0, 0.1]], 0.025, surface, sides=5)]  # fmt: skip
    return join(parts).moved(at, pitch=-pitch)


def banner(rng: np.random.Generator, low: float, radius: float, side: int, fabric: Surface, rod: Surface) -> Mesh:
    """Return a banner of 0.45 to 0.8 m by 1 to 2.2 m between two rods beside a mast; `side` is 1 for +y, -1 for -y."""
    width, tall, bulge = rng.uniform(0.45, 0.8), rng.uniform(1.0, 2.2), rng.uniform(-0.06, 0.06)
    f = np.linspace(0, 1, 5)
    grid = np.empty((5, 2, 3))
    grid[:, :, 0] = (bulge * np.sin(np.pi * f))[:, None]
    grid[:, :, 1] = side * np.array([radius + 0.05, radius + 0.05 + width])
    grid[:, :, 2] = (low + tall * f)[:, None]
    front = loft(np.concatenate([grid - [0.004, 0, 0], grid[:, ::-1] + [0.004, 0, 0]], axis=1), fabric)
    rods = [tube([[0, 0, z], [0, side * (radius + width + 0.1), z]], 0.014, rod, sides=4) for z in (low, low + tall)]
    return join([front, *rods])


def ballast(rng: np.random.Generator, at: ArrayLike, surface: Surface) -> Mesh:
    """Return a control box strapped to a mast."""
    size = rng.uniform([0.1, 0.2, 0.25], [0.2, 0.4, 0.6])
    return box(size, np.asarray(at, dtype=np.float64) - [size[0] / 2, 0, 0], surface)
