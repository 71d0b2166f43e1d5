"""Parts that all vehicles have: wheels, lamps, licence plates, mirrors, seats, a steering wheel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.materials import (
    SIGN_RED,
    SIGN_WHITE,
    SIGN_YELLOW,
    material,
    retroreflective,
)  # fmt: skip
from mlsroad_pipeline.simulation.model.meshes import Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, ellipsoid, tube
from mlsroad_pipeline.simulation.objects.bodywork import Body
from mlsroad_pipeline.simulation.objects.parts import lathe, tinted


def wheel(rng: np.random.Generator, radius: float, width: float, tyre: Surface, rim: Surface) -> Mesh:
    """Return a wheel of about 90 faces about the origin, its outer side towards +y; radius and width in metres."""
    hub = rng.uniform(0.56, 0.7)
    tread = [[1.0, -0.45], [1.0, 0.36], [hub, 0.5]]  # open towards the axle, which is out of view
    disc = [[hub, rng.uniform(0.2, 0.45)], [0.2, rng.uniform(0.1, 0.5)], [0.0, 0.35]]
    scale = np.array([radius, width])
    parts = [lathe(np.array(tread) * scale, tyre, sides=16), lathe(np.array(disc) * scale, rim, sides=10)]
    return join(parts).moved([0, 0, 0], roll=-np.pi / 2)


def wheels(rng: np.random.Generator, body: Body, label: str, *, width: float, steered: float = 0.0) -> list[Mesh]:
    """Return the wheels of a body, two per axle, with tyres of a `width`; front wheels turned by `steered` rad."""
    tyre = material("rubber", label, rng)
    one = wheel(rng, body.radius, width, tyre, material("aluminium", label, rng))
    out = body.half - width / 2 - 0.02
    meshes = []
    for x in body.axles:
        turn = steered if x == max(body.axles) else 0.0
        for side, yaw in ((1, 0.0), (-1, np.pi)):
            meshes.append(one.moved([x, side * out, body.radius], yaw=yaw + turn))
    return meshes


def lamps(
    rng: np.random.Generator, body: Body, label: str, *, front: float | None, rear: float | None, upright: bool = False
) -> list[Mesh]:  # fmt: skip
    """Return head lamps, tail lamps with reflectors, and licence plates.

    `front` and `rear` are the heights of the lamps in metres, None for an end without lamps and plate; `upright` tail
    lamps are higher than wide. Plates and reflectors are retro-reflective.
    """
    ends = np.array([body.top[0][0], body.top[-1][0]])
    w = body.half_width(ends)
    clear = tinted((0.6, 0.6, 0.58), label, 0.45, rng)
    red, white = retroreflective(SIGN_RED, label, rng), SIGN_WHITE if rng.random() < 0.8 else SIGN_YELLOW
    wide, tall = rng.uniform(0.13, 0.24), rng.uniform(0.045, 0.09)
    meshes = []
    for side in (-1, 1):
        if front is not None:
            at = [ends[1] - 0.07, side * (w[1] - 0.8 * wide), front]
            meshes.append(ellipsoid(at, [0.11, wide, tall], clear, rings=3, sides=6))
        if rear is not None:
            size = [0.07, 0.14, 0.34] if upright else [0.07, 0.34, 0.13]
            meshes.append(box(size, [ends[0] + 0.015, side * (w[0] - 0.5 * size[1]), rear], red))
    plate = retroreflective(white, label, rng)
    for end, sign, lit in ((ends[0], -1, rear), (ends[1], 1, front)):
        if lit is not None and (sign < 0 or rng.random() < 0.92):
            z = body.clear + rng.uniform(0.18, 0.4)
            meshes.append(box([0.012, rng.uniform(0.34, 0.52), 0.12], [end + sign * 0.012, 0, z], plate))
    return meshes


def mirrors(rng: np.random.Generator, body: Body, x: float, z: float, size: float, paint: Surface) -> list[Mesh]:
    """Return two outside mirrors on their feet; `size` is half their height, metres."""
    out = body.half + rng.uniform(0.04, 0.09)
    radii = [0.55 * size, rng.uniform(0.09, 0.12), size]
    meshes = []
    for side in (-1, 1):
        meshes.append(ellipsoid([x, side * out, z], radii, paint, rings=3, sides=6))
        meshes.append(tube([[x, side * 0.9 * body.half, z - 0.5 * size], [x, side * out, z]], 0.025, paint, sides=4))
    return meshes


def seats(
    label: str, rng: np.random.Generator, xs: Sequence[float], ys: Sequence[float], z: float, tall: float
) -> list[Mesh]:
    """Return seats (cushion, back and head rest) in rows `xs` at places `ys`.

    `z` is the height of the cushions, `tall` that of the backs with head rests above them, metres.
    """
    cover = material("seat", label, rng)
    tilt = rng.uniform(0.1, 0.35)
    one = join([
        box([0.48, 0.48, 0.14], [0.12, 0, -0.02], cover),
        box([0.12, 0.46, 0.72 * tall], [0, 0, 0.36 * tall], cover).moved([-0.1, 0, 0], pitch=-tilt),
        box([0.08, 0.26, 0.2 * tall], [0, 0, 0.88 * tall], cover).moved([-0.1, 0, 0], pitch=-tilt),
    ])  # fmt: skip
    return [one.moved([x, y, z]) for x in xs for y in ys]


def steering_wheel(label: str, at: Sequence[float], rng: np.random.Generator) -> Mesh:
    """Return a steering wheel, tilted towards the seat behind it."""
    dark = Surface(TAXONOMY[label], (0.03, 0.03, 0.03), float(rng.uniform(0.1, 0.3)))
    turn = np.linspace(0, 2 * np.pi, 9)
    ring = np.column_stack([0 * turn, 0.18 * np.cos(turn), 0.18 * np.sin(turn)])
    return tube(ring, 0.018, dark, sides=3).moved(at, pitch=-0.45)
