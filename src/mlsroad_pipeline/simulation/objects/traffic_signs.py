"""Traffic signs: plates of every common shape with border, field and mark, and their posts; fronts along +x.

Lower edges are mostly 2.0 to 2.5 m above the ground.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.simulation.model.materials import SIGN, Colour, material, retroreflective
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, polygon, tube
from mlsroad_pipeline.simulation.objects.parts import (
    UNDERGROUND,
    lathe,
    leaned,
    panel,
    rectangle,
    rounded,
    tinted,
    without_slivers,
)

SHAPES = ("round", "triangle", "yield", "square", "rectangle", "octagon", "diamond", "arrow")

_ORANGE: Colour = (0.6, 0.22, 0.03)
# Border, field of each shape; without a field (None) all has the border's colour.
_COLOURS: dict[str, Sequence[tuple[Colour, Colour | None]]] = {
    "round": [(SIGN.red, SIGN.white), (SIGN.blue, None), (SIGN.red, SIGN.blue), (SIGN.red, SIGN.yellow)],
    "triangle": [(SIGN.red, SIGN.white), (SIGN.red, SIGN.yellow)],
    "yield": [(SIGN.red, SIGN.white), (SIGN.red, SIGN.yellow)],
    "square": [(SIGN.blue, None), (SIGN.white, SIGN.blue), (SIGN.white, SIGN.green)],
    "rectangle": [(SIGN.blue, None), (SIGN.white, None), (SIGN.white, SIGN.green), (SIGN.yellow, None)],
    "octagon": [(SIGN.white, SIGN.red), (SIGN.red, None)],
    "diamond": [(SIGN.white, SIGN.yellow), (SIGN.yellow, None), (_ORANGE, None)],
    "arrow": [(SIGN.white, None), (SIGN.yellow, None), (SIGN.blue, None)],
}


def _outline(shape: str, rng: np.random.Generator) -> NDArray[np.float64]:
    size = rng.uniform(0.6, 0.9)
    if shape == "rectangle":
        long, short = rng.uniform(0.5, 1.0), rng.uniform(0.3, 0.6)
        return rounded(*((long, short) if rng.random() < 0.45 else (short, long)), 0.04)
    if shape == "arrow":
        return _arrow(rng.uniform(0.8, 1.4), rng.uniform(0.22, 0.4), right=rng.random() < 0.5)
    side = 1.12 * size / np.sqrt(3)  # of a triangle of 0.7 to 1 m
    return {
        "round": polygon(20, size / 2, start=np.pi / 20),
        "octagon": polygon(8, size / 2 / np.cos(np.pi / 8), start=np.pi / 8),
        "triangle": polygon(3, side, start=np.pi / 2),
        "yield": polygon(3, side, start=-np.pi / 2),
        "diamond": polygon(4, 0.68 * size, start=0.0),
        "square": rounded(0.85 * size, 0.85 * size, 0.05),
    }[shape]


def _arrow(long: float, high: float, *, right: bool) -> NDArray[np.float64]:
    tip = 0.6 * high
    left, body = -long / 2, long / 2 - tip
    outline = np.array([[left, -high / 2], [body, -high / 2], [long / 2, 0], [body, high / 2], [left, high / 2]])
    return outline if right else (outline * [-1, 1])[::-1]


def sign_plate(rng: np.random.Generator, shape: str | None = None) -> tuple[Mesh, float]:
    """Return the plate of a sign of a shape, drawn by default, middle at the origin, facing +x; and half its height.

    The plate is retro-reflective beside its mark; every face is `traffic_sign`.
    """
    name = shape or str(rng.choice(SHAPES, p=[0.28, 0.15, 0.08, 0.12, 0.17, 0.06, 0.07, 0.07]))
    outline = _outline(name, rng)
    middle = (outline.max(axis=0) + outline.min(axis=0)) / 2
    outline = outline - middle
    choices = _COLOURS[name]
    border, field = choices[int(rng.integers(len(choices)))]
    back = material("sign_back", "traffic_sign", rng)
    parts = [panel(outline, retroreflective(border, "traffic_sign", rng), back, [0, 0, 0])]
    inner = outline.mean(axis=0)
    if field is not None:
        margin = rng.uniform(0.68, 0.8) if name in ("round", "triangle", "yield") else rng.uniform(0.86, 0.94)
        sheet = retroreflective(field, "traffic_sign", rng)
        parts.append(panel((outline - inner) * margin + inner, sheet, sheet, [0.005, 0, 0]))
    parts += _marks(rng, outline, inner, field or border)
    return join(parts), float(np.ptp(outline[:, 1]) / 2)


def _marks(
    rng: np.random.Generator, outline: NDArray[np.float64], middle: NDArray[np.float64], field: Colour
) -> list[Mesh]:
    """Return bars and discs in place of symbols and letters."""
    dark = tinted((0.04, 0.04, 0.045), "traffic_sign", 0.12, rng)
    mark = dark if sum(field) > 0.9 else retroreflective(SIGN.white, "traffic_sign", rng)
    # The largest box about the middle that fits an outline is half as wide where it has three or four corners.
    reach = np.abs(outline - middle).max(axis=0) * (0.5 if len(outline) < 5 else 1.0)
    parts = []
    for _ in range(int(rng.integers(0, 4))):
        size = rng.uniform([0.08, 0.06], [0.5, 0.35]) * reach
        at = middle + rng.uniform(-0.25, 0.25, 2) * reach
        shape = rectangle(2 * size[0], 2 * size[1]) if rng.random() < 0.7 else polygon(8, float(size.min()))
        parts.append(panel(shape, mark, mark, [0.01, at[0], at[1]]))
    return parts


def board(rng: np.random.Generator, width: float, height: float, colour: Colour, at: ArrayLike, yaw: float) -> Mesh:
    """Return a direction board with its middle at `at`, facing `yaw` radians counter-clockwise from +x.

    It has a border, a field of a colour, lines of text and stiffeners behind; every face is `traffic_sign`.
    """
    back = material("sign_back", "traffic_sign", rng)
    light = retroreflective(SIGN.white, "traffic_sign", rng)
    field = retroreflective(colour, "traffic_sign", rng)
    radius = 0.08 * min(width, height)
    parts = [
        panel(rounded(width, height, radius), light, back, [0, 0, 0]),
        panel(rounded(width - 0.08, height - 0.08, radius), field, field, [0.005, 0, 0]),
    ]
    ink: Surface = light if sum(colour) < 1.5 else tinted((0.04, 0.04, 0.05), "traffic_sign", 0.12, rng)
    lines = max(int(height / rng.uniform(0.35, 0.6)), 1)
    for k in range(lines):
        long = width * rng.uniform(0.35, 0.8)
        z = height * ((k + 0.5) / lines - 0.5)
        y = rng.uniform(-0.5, 0.5) * (0.85 * width - long)
        parts.append(panel(rectangle(long, 0.35 * height / lines), ink, ink, [0.01, y, z]))
    for z in (-0.3 * height, 0.3 * height):
        parts.append(tube([[-0.035, -0.48 * width, z], [-0.035, 0.48 * width, z]], 0.025, back, sides=4))
    return join(parts).moved(at, yaw=yaw)


BOARD_COLOURS: tuple[Colour, ...] = (SIGN.blue, SIGN.green, SIGN.white, SIGN.yellow)
"""Colours of the fields of direction boards."""


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
        parts += [plate.moved([out * np.cos(back), 0, z], yaw=yaw), box([2.2 * radius, 0.1, 0.03], [0, 0, z], metal)]
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
    colour = [SIGN.blue, SIGN.green, SIGN.white][int(rng.integers(3))]
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
    light, red = retroreflective(SIGN.white, "traffic_sign", rng), retroreflective(SIGN.red, "traffic_sign", rng)
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
