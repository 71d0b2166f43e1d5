"""Builders of bins, mail boxes and cabinets for `street_furniture`; fronts along +x."""

import numpy as np

from mlsroad_pipeline.simulation.model.materials import SIGN, material
from mlsroad_pipeline.simulation.model.meshes import Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, ellipsoid, tube
from mlsroad_pipeline.simulation.objects.parts import (
    UNDERGROUND,
    lathe,
    leaned,
    loft,
    panel,
    prism,
    rectangle,
    rounded,
    tinted,
)

_LIDS = ((0.03, 0.16, 0.06), (0.03, 0.08, 0.3), (0.55, 0.42, 0.03), (0.25, 0.13, 0.05), (0.05, 0.05, 0.055))


def wheelie_bin(rng: np.random.Generator) -> Mesh:
    """Return a bin of two wheels, 80 to 240 litres, its lid shut, ajar or open."""
    body = tinted(_LIDS[int(rng.integers(5))] if rng.random() < 0.5 else (0.08, 0.08, 0.085), "bin", 0.25, rng)
    lid = tinted(_LIDS[int(rng.integers(5))], "bin", 0.3, rng)
    dark = material("rubber", "bin", rng)
    width, depth, height = np.array([0.46, 0.54, 0.93]) * rng.uniform(1.0, 1.25) * rng.uniform(0.94, 1.06, 3)
    levels = [(0.78, 0.04), (0.97, 0.82 * height), (1.0, 0.9 * height)]
    outline = np.column_stack([rounded(depth, width, 0.06), np.zeros(12)])
    parts = [loft([outline * [f, f, 1] + [0, 0, z] for f, z in levels], body)]
    open_by = rng.uniform(1.5, 3.9) if rng.random() < 0.08 else rng.choice([0.0, rng.uniform(0.0, 0.35)])
    side = [[0.0, 0.0], [1.06 * depth, 0.0], [1.02 * depth, 0.03], [0.3 * depth, 0.09], [0.0, 0.07]]
    hinge = [-0.53 * depth, 0, 0.9 * height]
    parts.append(prism(side, 1.06 * width, lid).moved(hinge, pitch=-open_by))
    axle = [-0.42 * depth, 0.1]
    for y in (-0.42 * width, 0.42 * width):
        parts.append(tube([[axle[0], y - 0.03, axle[1]], [axle[0], y + 0.03, axle[1]]], 0.1, dark, sides=10))
    grip = [[-0.6 * depth, y, 0.92 * height] for y in (-0.4 * width, 0.4 * width)]
    parts += [tube(grip, 0.018, body, sides=5), box([0.1, 0.7 * width, 0.06], [0.3 * depth, 0, 0.03], body)]
    return join(parts)


def large_container(rng: np.random.Generator) -> Mesh:
    """Return a container on four castors with a flat or a rounded lid."""
    body = tinted(_LIDS[int(rng.integers(5))], "bin", 0.3, rng, spread=0.3)
    lid = tinted(_LIDS[int(rng.integers(5))], "bin", 0.3, rng)
    dark = material("rubber", "bin", rng)
    width, depth, height = rng.uniform([1.15, 0.75, 1.0], [1.45, 1.1, 1.25])
    outline = np.column_stack([rounded(depth, width, 0.08), np.zeros(12)])
    parts = [loft([outline * [f, f, 1] + [0, 0, z] for f, z in ((0.84, 0.2), (1.0, height))], body)]
    f = np.linspace(0, np.pi, 7)
    rise = rng.uniform(0.05, 0.4)
    parts.append(
        prism(np.column_stack([-0.52 * depth * np.cos(f), height + rise * np.sin(f)])[::-1], 1.03 * width, lid)
    )
    for x in (-0.3 * depth, 0.3 * depth):
        for y in (-0.36 * width, 0.36 * width):
            parts.append(tube([[x, y - 0.025, 0.1], [x, y + 0.025, 0.1]], 0.1, dark, sides=8))
            parts.append(box([0.05, 0.03, 0.15], [x, y, 0.17], dark))
    for y in (-0.52 * width, 0.52 * width):
        parts.append(tube([[-0.06, y, 0.8 * height], [0.06, y, 0.8 * height]], 0.03, body, sides=6))
    return join(parts)


def litter_bin(rng: np.random.Generator) -> Mesh:
    """Return a round or square litter bin that stands on the pavement, with a hood or an open mouth."""
    skin = material(str(rng.choice(["plastic", "galvanised", "painted_metal", "concrete"])), "bin", rng)
    radius, height = rng.uniform(0.18, 0.32), rng.uniform(0.7, 1.05)
    sides, belly = int(rng.choice([4, 6, 12, 12])), rng.uniform(0.85, 1.15)
    turn = np.pi / 4 if sides == 4 else 0.0
    profile = [[0.9 * radius, -0.1], [0.9 * radius, 0], [belly * radius, 0.5 * height], [radius, height]]
    if rng.random() < 0.5:  # hood over the mouth
        hood = rng.uniform(0.12, 0.22)
        rods = [[0.85 * radius * np.cos(a), 0.85 * radius * np.sin(a)] for a in turn + np.arange(4) * np.pi / 2]
        parts = [lathe([*profile, [0.8 * radius, height]], skin, sides=sides)]
        parts += [tube([[x, y, height], [x, y, height + hood]], 0.012, skin, sides=4) for x, y in rods]
        cap = [[radius, height + hood], [0.9 * radius, height + hood + 0.05], [0, height + hood + 0.1]]
        parts.append(lathe(cap, skin, sides=sides))
    else:
        dark = material("rubber", "bin", rng)
        inner = [[0.0, height - 0.25], [0.75 * radius, height - 0.25], [0.8 * radius, height]]
        parts = [lathe([*profile, [0.8 * radius, height]], skin, sides=sides), lathe(inner, dark, sides=sides)]
    return join(parts).moved([0, 0, 0], yaw=turn)


def post_bin(rng: np.random.Generator) -> Mesh:
    """Return a bin in front of its own post."""
    metal = material("galvanised", "bin", rng)
    skin = tinted(_LIDS[int(rng.integers(5))], "bin", 0.3, rng, spread=0.4)
    height, radius, tall = rng.uniform(0.85, 1.2), rng.uniform(0.14, 0.21), rng.uniform(0.38, 0.6)
    post = tube([[0, 0, -UNDERGROUND], [0, 0, height + rng.uniform(0.02, 0.25)]], rng.uniform(0.025, 0.04), metal)
    sides = int(rng.choice([4, 10]))
    pail = [[0.0, 0.0], [0.8 * radius, 0.0], [radius, tall], [0.85 * radius, tall], [0.7 * radius, 0.04], [0, 0.04]]
    body = lathe(pail, skin, sides=sides).moved([0, 0, 0], yaw=np.pi / 4 if sides == 4 else 0.0)
    body = body.moved([radius + 0.05, 0, height - tall])
    bracket = box([0.06, 0.1, 0.05], [0.04, 0, height - 0.4 * tall], metal)
    return leaned(join([post, body, bracket]), rng)


def bottle_bank(rng: np.random.Generator) -> Mesh:
    """Return a bell for glass or paper with insertion holes."""
    skin = tinted(_LIDS[int(rng.integers(5))], "bin", 0.35, rng, spread=0.3)
    dark = material("rubber", "bin", rng)
    radius, height = rng.uniform(0.6, 0.85), rng.uniform(1.4, 1.8)
    bell = [[0.95, 0.0], [1.0, 0.12], [1.0, 0.55], [0.82, 0.8], [0.4, 0.97], [0.0, 1.0]]
    parts = [lathe(np.array(bell) * [radius, height], skin, sides=int(rng.choice([4, 8, 16])))]
    for side in (-1, 1):
        at = [side * 0.86 * radius, 0, 0.74 * height]
        parts.append(ellipsoid(at, [0.1, 0.14, 0.12], dark, rings=3, sides=8))
    return join([*parts, tube([[0, 0, height - 0.02], [0, 0, height + 0.1]], 0.04, dark, sides=5)])


def pillar_box(rng: np.random.Generator) -> Mesh:
    """Return a round mail box that stands on the ground."""
    skin = tinted(SIGN.red if rng.random() < 0.6 else SIGN.yellow, "mail_box", 0.4, rng)
    dark = material("rubber", "mail_box", rng)
    radius, height = rng.uniform(0.2, 0.3), rng.uniform(1.2, 1.65)
    profile = [[1.1, -0.1], [1.1, 0.06], [1.0, 0.08], [1.0, 0.86], [1.12, 0.88], [1.08, 0.93], [0, 1.0]]
    body = lathe(np.array(profile) * [radius, height], skin, sides=14)
    slot = panel(rectangle(1.1 * radius, 0.05), dark, dark, [radius + 0.004, 0, 0.8 * height])
    return join([body, slot])


def mail_box(rng: np.random.Generator) -> Mesh:
    """Return a mail box on a foot or on legs, its top flat, sloping or rounded."""
    red, blue = SIGN.red, (0.03, 0.1, 0.4)
    colour = [SIGN.yellow, red, blue][int(rng.integers(3))]
    skin = tinted(colour, "mail_box", 0.4, rng, spread=0.25)
    metal, dark = material("galvanised", "mail_box", rng), material("rubber", "mail_box", rng)
    width, depth, tall = rng.uniform([0.32, 0.26, 0.45], [0.6, 0.55, 0.85])
    low, rise, kind = rng.uniform(0.2, 0.7), rng.uniform(0.05, 0.25), int(rng.integers(3))
    top = low + tall
    if kind == 0:
        cap = [[depth / 2, top], [-depth / 2, top + 0.3 * rise]]
    elif kind == 1:
        cap = [[0.3 * depth, top + 0.8 * rise], [-0.3 * depth, top + rise]]
    else:
        f = np.linspace(0, np.pi, 7)
        cap = np.column_stack([depth / 2 * np.cos(f), top + rise * np.sin(f)]).tolist()
    outline = np.array([[-depth / 2, low], [depth / 2, low], *cap, [-depth / 2, top]])
    # Repeated corners of a cap would make faces without area.
    keep = np.hypot(*(outline - np.roll(outline, 1, axis=0)).T) > 1e-6
    parts = [prism(outline[keep], width, skin)]
    parts.append(panel(rectangle(0.7 * width, 0.04), dark, dark, [depth / 2 + 0.004, 0, top - 0.12]))
    if rng.random() < 0.5:
        parts.append(box([0.1, 0.1, low + UNDERGROUND], [0, 0, (low - UNDERGROUND) / 2], metal))
    else:
        for x in (-0.4 * depth, 0.4 * depth):
            for y in (-0.42 * width, 0.42 * width):
                parts.append(box([0.04, 0.04, low + UNDERGROUND], [x, y, (low - UNDERGROUND) / 2], skin))
    return join(parts)


def cabinet(rng: np.random.Generator) -> Mesh:
    """Return a cabinet of a telephone, power or signal company, sometimes with stickers."""
    skin = tinted((0.3, 0.32, 0.28), "other_object", 0.35, rng, spread=0.35)
    concrete = material("concrete", "other_object", rng)
    width, depth, tall = rng.uniform([0.45, 0.25, 0.75], [1.6, 0.6, 1.55])
    plinth, over = rng.uniform(0.04, 0.2), rng.uniform(0.01, 0.04)
    parts = [
        box([depth + 0.04, width + 0.04, plinth + UNDERGROUND], [0, 0, (plinth - UNDERGROUND) / 2], concrete),
        box([depth, width, tall - plinth], [0, 0, (tall + plinth) / 2], skin),
        box([depth + 2 * over, width + 2 * over, 0.05], [0, 0, tall + 0.025], skin, taper=rng.uniform(0.9, 1.0)),
    ]
    for y in np.linspace(-width / 2, width / 2, int(rng.integers(2, 4)) + 1)[1:-1]:
        seam = material("rubber", "other_object", rng)
        parts.append(box([0.01, 0.012, 0.9 * (tall - plinth)], [depth / 2, y, (tall + plinth) / 2], seam))
    for _ in range(int(rng.poisson(0.8))):
        size = rng.uniform(0.06, 0.25, 2)
        hue = rng.uniform(0.05, 0.8, 3)
        paper: Surface = tinted((float(hue[0]), float(hue[1]), float(hue[2])), "other_object", 0.5, rng)
        y, z = rng.uniform(-0.3, 0.3) * width, rng.uniform(0.4, 0.8) * tall
        parts.append(panel(rectangle(*size), paper, paper, [depth / 2 + 0.004, y, z]))
    return join(parts)


def parking_meter(rng: np.random.Generator) -> Mesh:
    """Return a meter with one or two heads on a post."""
    metal = material("galvanised", "parking_meter", rng)
    skin = tinted((0.15, 0.17, 0.18), "parking_meter", 0.3, rng, spread=0.4)
    height, radius = rng.uniform(0.95, 1.2), rng.uniform(0.025, 0.035)
    parts = [tube([[0, 0, -UNDERGROUND], [0, 0, height]], radius, metal)]
    heads = (0.0,) if rng.random() < 0.7 else (-0.11, 0.11)
    f = np.linspace(0, np.pi, 6)
    wide, tall = rng.uniform(0.07, 0.1), rng.uniform(0.18, 0.26)
    for y in heads:
        arch = np.column_stack([wide * np.cos(f), tall + wide * np.sin(f)])
        outline = np.concatenate([[[-0.7 * wide, 0], [0.7 * wide, 0]], arch])
        parts.append(prism(outline, 0.11, skin).moved([0, 0, 0], yaw=np.pi / 2).moved([0, y, height]))
        face = tinted((0.5, 0.52, 0.5), "parking_meter", 0.4, rng)
        parts.append(panel(rectangle(wide, 0.08), face, face, [0.058, y, height + tall]))
    if len(heads) == 2:
        parts.append(box([0.06, 0.3, 0.03], [0, 0, height], metal))
    return leaned(join(parts), rng)


def pay_station(rng: np.random.Generator) -> Mesh:
    """Return a ticket machine, some with a solar panel or a round P above."""
    skin = tinted((0.1, 0.13, 0.2), "parking_meter", 0.3, rng, spread=0.5)
    width, depth, tall = rng.uniform([0.3, 0.22, 1.35], [0.45, 0.35, 1.75])
    side = [[-depth / 2, -0.1], [depth / 2, -0.1], [depth / 2, 0.62 * tall], [0.2 * depth, tall], [-depth / 2, tall]]
    parts = [prism(side, width, skin)]
    screen = tinted((0.4, 0.45, 0.4), "parking_meter", 0.4, rng)
    parts.append(panel(rectangle(0.6 * width, 0.16), screen, screen, [depth / 2 + 0.004, 0, 0.5 * tall]))
    if rng.random() < 0.5:
        post = tube([[0, 0, tall], [0, 0, tall + 0.5]], 0.025, skin, sides=6)
        sheet = tinted((0.03, 0.1, 0.45), "parking_meter", 0.4, rng)
        letter = tinted(SIGN.white, "parking_meter", 0.6, rng)
        parts += [post, panel(rectangle(0.34, 0.34), sheet, sheet, [0.03, 0, tall + 0.5]),
                  panel(rectangle(0.12, 0.22), letter, letter, [0.035, 0, tall + 0.5])]  # fmt: skip
    return join(parts)
