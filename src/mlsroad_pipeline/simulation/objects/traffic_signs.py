"""Traffic signs: plates on their own posts, fronts along +x, lower edges mostly 2.0 to 2.5 m above the ground."""

from __future__ import annotations

from functools import partial

import numpy as np

from mlsroad_pipeline.simulation.model.design import Design
from mlsroad_pipeline.simulation.model.materials import (
    SIGN_BLUE,
    SIGN_GREEN,
    SIGN_RED,
    SIGN_WHITE,
    material,
    retroreflective,
)
from mlsroad_pipeline.simulation.model.meshes import Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, tube
from mlsroad_pipeline.simulation.objects.parts import (
    UNDERGROUND,
    lathe,
    leaned,
    panel,
    rectangle,
    rounded,
    without_slivers,
)
from mlsroad_pipeline.simulation.objects.sign_plates import BOARD_COLOURS, board, sign_plate


def _post(rng: np.random.Generator, height: float, metal: Surface, y: float = 0.0) -> tuple[list[Mesh], float]:
    """Return a post, a tube or a channel, and the distance of its front from its axis."""
    if rng.random() < 0.8:
        radius = rng.uniform(0.024, 0.045)
        parts = [tube([[0, y, -UNDERGROUND], [0, y, height]], radius, metal, sides=8)]
    else:
        radius = rng.uniform(0.02, 0.035)
        size = [1.4 * radius, 2.4 * radius, height + UNDERGROUND]
        parts = [box(size, [0, y, (height - UNDERGROUND) / 2], metal)]
    if rng.random() < 0.25:
        foot = rng.uniform(0.05, 0.14)
        parts.append(lathe([[foot, -0.1], [foot, 0.04], [radius, 0.1]], metal, at=[0, y, 0], sides=8))
    return parts, radius


def _single(rng: np.random.Generator, *, shape: str) -> Mesh:
    metal = material("galvanised", "traffic_sign", rng)
    plate, half = sign_plate(rng, shape)
    bottom = rng.uniform(2.0, 2.5) if rng.random() < 0.8 else rng.uniform(0.7, 2.0)
    parts, radius = _post(rng, bottom + 2 * half - rng.uniform(-0.06, 0.1), metal)
    parts.append(plate.moved([radius + 0.02, 0, bottom + half], yaw=rng.normal(0, 0.08), roll=rng.normal(0, 0.025)))
    parts += [box([0.03, 0.1, 0.03], [0.8 * radius, 0, bottom + half + dz], metal) for dz in (-0.5 * half, 0.5 * half)]
    return leaned(join(parts), rng, share=0.35)


def _several_plates(rng: np.random.Generator) -> Mesh:
    """Return two or three plates one above the other, some of which face backwards."""
    metal = material("galvanised", "traffic_sign", rng)
    top, level = rng.uniform(2.0, 2.4), []
    for k in range(int(rng.choice([2, 3], p=[0.7, 0.3]))):
        plate, half = sign_plate(rng, "rectangle" if k == 0 and rng.random() < 0.5 else None)
        level.append((plate, top + half))
        top += 2 * half + rng.uniform(0.02, 0.1)
    parts, radius = _post(rng, top - 0.05, metal)
    for plate, z in level:
        back = np.pi if rng.random() < 0.15 else 0.0
        yaw = back + rng.normal(0, 0.06)
        out = radius + 0.02
        parts.append(plate.moved([out * np.cos(back), 0, z], yaw=yaw))
        parts.append(box([2.2 * radius, 0.1, 0.03], [0, 0, z], metal))
    return leaned(join(parts), rng, share=0.35)


def _two_posts(rng: np.random.Generator) -> Mesh:
    """Return a direction board on two posts."""
    metal = material("galvanised", "traffic_sign", rng)
    width, tall, bottom = rng.uniform(1.2, 3.0), rng.uniform(0.5, 1.6), rng.uniform(1.2, 2.3)
    colour = BOARD_COLOURS[int(rng.integers(len(BOARD_COLOURS)))]
    apart, parts, radius = width * rng.uniform(0.5, 0.75), [], 0.0
    for y in (-apart / 2, apart / 2):
        post, radius = _post(rng, bottom + tall - 0.05, metal, y)
        parts += post
    parts.append(board(rng, width, tall, colour, [radius + 0.06, 0, bottom + tall / 2], rng.normal(0, 0.03)))
    return leaned(join(parts), rng)


def _street_names(rng: np.random.Generator) -> Mesh:
    """Return blades with street names, crossed on one post, legible from both sides."""
    metal = material("galvanised", "traffic_sign", rng)
    colour = [SIGN_BLUE, SIGN_GREEN, SIGN_WHITE][int(rng.integers(3))]
    height = rng.uniform(2.3, 3.1)
    parts, _ = _post(rng, height, metal)
    for k in range(int(rng.integers(1, 3))):
        sheet = retroreflective(colour, "traffic_sign", rng)
        long, tall = rng.uniform(0.6, 1.1), rng.uniform(0.15, 0.25)
        outline = rounded(long, tall, 0.03)
        out = rng.choice([0.0, long / 2])
        blade = panel(outline, sheet, sheet, [0, out, height - 0.15 - 0.27 * k])
        parts.append(blade.moved([0, 0, 0], yaw=np.pi / 2 * k + rng.normal(0, 0.1)))
    return leaned(join(parts), rng, share=0.35)


def _chevron(rng: np.random.Generator) -> Mesh:
    """Return a low board with stripes for a bend, an island or road works."""
    metal = material("galvanised", "traffic_sign", rng)
    width, tall, bottom = rng.uniform(0.25, 0.6), rng.uniform(0.5, 1.0), rng.uniform(0.25, 1.2)
    parts, radius = _post(rng, bottom + tall, metal)
    light, red = retroreflective(SIGN_WHITE, "traffic_sign", rng), retroreflective(SIGN_RED, "traffic_sign", rng)
    back = material("sign_back", "traffic_sign", rng)
    parts.append(panel(rectangle(width, tall), light, back, [radius + 0.02, 0, bottom + tall / 2]))
    slant, n = rng.uniform(-0.12, 0.12), int(rng.integers(2, 5))
    for k in range(n):
        low = tall * ((k + 0.3) / n - 0.5)
        high = low + 0.45 * tall / n
        stripe = np.array([[-width / 2, low], [width / 2, low + slant], [width / 2, high + slant], [-width / 2, high]])
        stripe[:, 1] = np.clip(stripe[:, 1], -tall / 2, tall / 2)
        parts.append(panel(stripe, red, red, [radius + 0.027, 0, bottom + tall / 2]))
    return leaned(without_slivers(join(parts)), rng, share=0.35)


_sign = partial(Design, label="traffic_sign", clearance=0.5)

DESIGNS: tuple[Design, ...] = (
    _sign("round_sign", build=partial(_single, shape="round"), weight=3.0),
    _sign("triangular_sign", build=partial(_single, shape="triangle"), weight=1.2),
    _sign("yield_sign", build=partial(_single, shape="yield"), weight=0.8),
    _sign("rectangular_sign", build=partial(_single, shape="rectangle"), weight=1.5),
    _sign("square_sign", build=partial(_single, shape="square"), weight=1.2),
    _sign("octagonal_sign", build=partial(_single, shape="octagon"), weight=0.8),
    _sign("diamond_sign", build=partial(_single, shape="diamond"), weight=0.7),
    _sign("arrow_sign", build=partial(_single, shape="arrow"), weight=0.4, clearance=0.8),
    _sign("several_plates_sign", build=_several_plates, weight=2.0),
    _sign("two_post_sign", build=_two_posts, weight=0.6, clearance=1.3),
    _sign("street_name_sign", build=_street_names, weight=0.8),
    _sign("chevron_board", build=_chevron, weight=0.4),
)
"""Traffic signs."""
