"""Bus stops: station signs face +x; shelters open along +x, their length along y."""

import numpy as np

from mlsroad_pipeline.simulation.model.materials import SIGN, cloth, material, retroreflective
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, polygon, quads, tube
from mlsroad_pipeline.simulation.objects.parts import (
    UNDERGROUND,
    grid_skin,
    lathe,
    leaned,
    loft,
    panel,
    prism,
    rectangle,
    rounded,
    tinted,
)

_COLOURS = (SIGN.blue, SIGN.green, SIGN.red, SIGN.white, SIGN.yellow)


def _card(rng: np.random.Generator, metal: Surface) -> Mesh:
    """Return a timetable case."""
    paper = tinted((0.6, 0.6, 0.58), "station_sign", 0.45, rng)
    width, tall, z = rng.uniform(0.25, 0.45), rng.uniform(0.35, 0.8), rng.uniform(1.3, 1.6)
    case = box([0.04, width, tall], [0.06, 0, z], metal)
    return join([case, panel(rectangle(0.9 * width, 0.92 * tall), paper, paper, [0.083, 0, z])])


def _flag(rng: np.random.Generator) -> Mesh:
    """Return a plate that projects from a post like a flag, with the mark of the stop on both sides."""
    metal = material("galvanised", "station_sign", rng)
    height, radius = rng.uniform(2.5, 3.2), rng.uniform(0.026, 0.04)
    sheet = retroreflective(_COLOURS[int(rng.integers(5))], "station_sign", rng)
    mark = retroreflective(SIGN.white, "station_sign", rng)
    size, side = rng.uniform(0.36, 0.6), float(rng.choice([-1, 1]))
    outline = rounded(size, size * rng.uniform(0.9, 1.5), 0.05) if rng.random() < 0.6 else polygon(16, size / 2)
    half = float(outline[:, 1].max())
    y, z = side * (radius + size / 2), height - half - 0.03
    parts = [tube([[0, 0, -UNDERGROUND], [0, 0, height]], radius, metal), panel(outline, sheet, sheet, [0, y, z])]
    parts += [panel(outline * 0.45, mark, mark, [x, y, z]) for x in (-0.008, 0.008)]
    parts += [tube([[0, 0, z + dz], [0, y, z + dz]], 0.012, metal, sides=4) for dz in (-0.6 * half, 0.6 * half)]
    if rng.random() < 0.75:
        parts.append(_card(rng, metal))
    return leaned(join(parts), rng)


def _totem(rng: np.random.Generator) -> Mesh:
    """Return a slim pillar with coloured head and timetable."""
    skin = tinted((0.2, 0.22, 0.24), "station_sign", 0.3, rng, spread=0.5)
    head = retroreflective(_COLOURS[int(rng.integers(5))], "station_sign", rng)
    width, deep, height = rng.uniform(0.3, 0.6), rng.uniform(0.1, 0.2), rng.uniform(2.2, 3.4)
    outline = np.column_stack([rounded(deep, width, 0.04), np.zeros(12)])
    cut = height - rng.uniform(0.4, 0.7)
    lower = loft([outline + np.array([0, 0, z]) for z in (-UNDERGROUND, cut)], skin)
    upper = loft([outline + np.array([0, 0, z]) for z in (cut, height)], head)
    paper = tinted((0.6, 0.6, 0.58), "station_sign", 0.45, rng)
    sheets = [panel(rectangle(0.8 * width, 0.9), paper, paper, [x * (deep / 2 + 0.004), 0, 1.35]) for x in (-1, 1)]
    return leaned(join([lower, upper, *sheets]), rng, share=0.1)


def _round_roof(depth: float, length: float, height: float, rise: float, skin: Surface) -> Mesh:
    """Return a barrel roof along y."""
    f = np.linspace(-0.5, 0.5, 7)
    arc = np.column_stack([depth * f, height + rise * (1 - 4 * f**2)])
    ring = np.concatenate([arc, arc[::-1] - [0, 0.05]])
    ends = np.array([length / 2, -length / 2])
    sections = np.empty((2, len(ring), 3))
    sections[:, :, [0, 2]], sections[:, :, 1] = ring, ends[:, None]
    # The end of a barrel roof is not convex: it is closed cell by cell.
    skirts = [np.stack([s[:7], s[:6:-1]]) for s in sections]
    return join([loft(sections, skin, closed=False), *(grid_skin(s, [skin]) for s in skirts)])


def _pane(corners: list[list[float]], glass: Surface, frame: Surface) -> list[Mesh]:
    edges = [tube([corners[k], corners[(k + 1) % 4]], 0.018, frame, sides=4) for k in (0, 2)]
    return [quads(corners, glass), *edges]


def _seat(rng: np.random.Generator, x: float, length: float, y: float, skin: Surface) -> list[Mesh]:
    parts = [box([0.34, length, 0.05], [x, y, rng.uniform(0.42, 0.5)], skin)]
    for side in (-0.4, 0.4):
        parts.append(box([0.24, 0.05, 0.42 + UNDERGROUND], [x, y + side * length, (0.42 - UNDERGROUND) / 2], skin))
    return parts


def _glass_shelter(rng: np.random.Generator) -> Mesh:
    """Return a shelter of posts, a roof, panes behind and at the sides, a bench and usually a poster case."""
    metal, glass = material("painted_metal", "bus_shelter", rng), material("glass", "bus_shelter", rng)
    length, depth, height = rng.uniform([2.6, 1.1, 2.25], [5.2, 1.7, 2.6])
    back, low, high = -depth / 2, rng.uniform(0.1, 0.3), height - rng.uniform(0.05, 0.3)
    bays = int(rng.integers(2, 5))
    ys = np.linspace(-length / 2, length / 2, bays + 1)
    thick, parts = rng.uniform(0.05, 0.09), []
    fronts = [(depth / 2, y) for y in ys[[0, -1]]] if rng.random() < 0.7 else []
    for x, y in [*((back, y) for y in ys), *fronts]:
        parts.append(box([thick, thick, height + UNDERGROUND], [x, y, (height - UNDERGROUND) / 2], metal))
    for a, b in zip(ys[:-1] + 0.05, ys[1:] - 0.05, strict=True):
        parts += _pane([[back, a, low], [back, b, low], [back, b, high], [back, a, high]], glass, metal)
    reach = depth / 2 if rng.random() < 0.6 else 0.0
    poster = int(rng.integers(3))  # none, or the case at one of the ends
    for k, y in enumerate(ys[[0, -1]]):
        if poster == k + 1:
            parts.append(box([0.85 * depth, 0.12, 1.8], [0, y, 1.2], cloth("bus_shelter", rng)))
        elif rng.random() < 0.8:
            parts += _pane([[back, y, low], [reach, y, low], [reach, y, high], [back, y, high]], glass, metal)
    over = rng.uniform(0.1, 0.5)
    if rng.random() < 0.4:
        roof = glass if rng.random() < 0.4 else metal
        parts.append(_round_roof(depth + over, length + over, height, rng.uniform(0.08, 0.3), roof))
    else:
        parts.append(box([depth + over, length + over, rng.uniform(0.06, 0.16)], [over / 4, 0, height + 0.05], metal))
    if rng.random() < 0.85:
        parts += _seat(rng, back + 0.3, length * rng.uniform(0.3, 0.7), rng.normal(0, 0.1), metal)
    return join(parts)


def _solid_shelter(rng: np.random.Generator) -> Mesh:
    """Return a shelter with walls of brick, concrete or wood on three sides under a pitched or flat roof."""
    skin = material(str(rng.choice(["brick", "concrete", "wood", "plaster"])), "bus_shelter", rng)
    tile = material(str(rng.choice(["roof_tile", "wood", "concrete"])), "bus_shelter", rng)
    length, depth, height = rng.uniform([2.4, 1.3, 2.1], [4.5, 2.0, 2.5])
    thick, tall = rng.uniform(0.08, 0.22), height + UNDERGROUND
    z = (height - UNDERGROUND) / 2
    parts = [box([thick, length, tall], [-depth / 2 + thick / 2, 0, z], skin)]
    parts += [box([depth, thick, tall], [0, side * (length - thick) / 2, z], skin) for side in (-1, 1)]
    rise = rng.uniform(0.0, 0.6)
    eave, ends = depth / 2 + rng.uniform(0.1, 0.35), length / 2 + rng.uniform(0.1, 0.3)
    shoulder = height + rise * (1 - depth / 2 / eave)
    gable = [[-depth / 2, height], [depth / 2, height], [depth / 2, shoulder], [0, height + rise],
             [-depth / 2, shoulder]]  # fmt: skip
    for side in (-1, 1):
        parts.append(prism(gable, thick, skin, at=side * (length - thick) / 2))
        slope = np.array([[0, -ends, height + rise], [0, ends, height + rise], [side * eave, ends, height],
                          [side * eave, -ends, height]])  # fmt: skip
        parts += [quads(slope, tile), quads(slope + np.array([0, 0, 0.08]), tile)]
    return join([*parts, *_seat(rng, -depth / 2 + thick + 0.2, 0.8 * (length - 2 * thick), 0.0, skin)])


def _canopy(rng: np.random.Generator) -> Mesh:
    """Return a roof on one or two posts."""
    metal = material("painted_metal", "bus_shelter", rng)
    length, depth, height = rng.uniform([2.5, 1.2, 2.3], [5.0, 2.2, 2.9])
    posts = [0.0] if length < 3.2 else [-0.28 * length, 0.28 * length]
    parts = []
    for y in posts:
        parts.append(lathe([[0.08, -UNDERGROUND], [0.07, height]], metal, at=[0, y, 0]))
        parts.append(tube([[0, y, height - 0.35], [0.6 * depth, y, height]], 0.04, metal, sides=4))
    f = np.linspace(0, 1, 5)
    lift = rng.uniform(-0.1, 0.35) * f + rng.uniform(-0.15, 0.15) * f * (1 - f)
    arc = np.column_stack([depth * (f - 0.2), height + lift])
    low = np.stack([np.column_stack([arc[:, 0], np.full(5, y), arc[:, 1]]) for y in (length / 2, -length / 2)])
    parts += [grid_skin(low, [metal]), grid_skin(low + np.array([0, 0, 0.06]), [metal])]
    if rng.random() < 0.6:
        parts += _seat(rng, 0.1, 0.5 * length, 0.0, metal)
    return join(parts)


DESIGNS: tuple[Design, ...] = (
    Design("station_flag", "station_sign", _flag, 0.8, 2.0),
    Design("station_totem", "station_sign", _totem, 0.5),
    Design("glass_shelter", "bus_shelter", _glass_shelter, 3.0, 3.0),
    Design("solid_shelter", "bus_shelter", _solid_shelter, 2.7, 0.6),
    Design("canopy_shelter", "bus_shelter", _canopy, 2.8, 0.8),
)
