"""Street furniture: benches, bollards, hydrants, racks, planters, columns, and the bins and boxes of `bins`.

Fronts face +x; long sides are along y, the street.
"""

from itertools import pairwise

import numpy as np

from mlsroad_pipeline.simulation.model.materials import SIGN, cloth, material, retroreflective
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh, join
from mlsroad_pipeline.simulation.model.solids import box, leaves, tube
from mlsroad_pipeline.simulation.objects import bins
from mlsroad_pipeline.simulation.objects.parts import (
    UNDERGROUND,
    lathe,
    leaned,
    loft,
    panel,
    rectangle,
    rounded,
    tinted,
)


def _bench(rng: np.random.Generator) -> Mesh:
    """Return a bench of slats on two or three frames, with or without back and arm rests."""
    slat, leg = material("wood", "bench", rng), material("painted_metal", "bench", rng)
    length, height = rng.uniform(1.2, 2.2), rng.uniform(0.41, 0.49)
    wide, n = rng.uniform(0.06, 0.11), int(rng.integers(3, 6))
    parts = [box([wide, length, 0.035], [x, 0, height], slat) for x in np.linspace(-0.19, 0.19, n)]
    backed, tilt = rng.random() < 0.7, rng.uniform(0.1, 0.3)
    for dz in np.linspace(0.16, 0.4, int(rng.integers(2, 4))) if backed else []:
        parts.append(box([0.03, length, 0.09], [-0.23 - tilt * dz, 0, height + dz], slat))
    for y in np.linspace(-0.42, 0.42, 2 if length < 1.8 else 3) * length:
        for x in (-0.18, 0.18):
            parts.append(box([0.05, 0.05, height + UNDERGROUND], [x, y, (height - UNDERGROUND) / 2], leg))
        parts.append(box([0.42, 0.05, 0.04], [0, y, height - 0.04], leg))
        if backed:
            parts.append(tube([[-0.2, y, height], [-0.23 - 0.44 * tilt, y, height + 0.44]], 0.022, leg, sides=5))
    if backed and rng.random() < 0.5:
        for y in (-0.45 * length, 0.45 * length):
            parts.append(
                tube([[0.18, y, height], [0.18, y, height + 0.2], [-0.25, y, height + 0.22]], 0.02, leg, sides=5)
            )
    return join(parts)


def _block_bench(rng: np.random.Generator) -> Mesh:
    """Return a block of concrete or stone, straight or curved."""
    stone = material(str(rng.choice(["concrete", "stone"])), "bench", rng)
    length, deep, height = rng.uniform(1.3, 2.4), rng.uniform(0.4, 0.6), rng.uniform(0.4, 0.5)
    f, bow = np.linspace(-0.5, 0.5, 5), rng.choice([0.0, rng.uniform(0.05, 0.25)])
    ring = np.array(
        [[-0.5, -0.1], [0.5, -0.1], [0.5, height - 0.03], [0.45, height], [-0.45, height], [-0.5, height - 0.03]]
    )
    sections = np.empty((5, 6, 3))
    sections[:, :, 0] = ring[:, 0] * deep + (bow * (1 - 4 * f**2))[:, None] - bow / 2
    sections[:, :, 1], sections[:, :, 2] = (-length * f)[:, None], ring[:, 1]
    return loft(sections, stone)


def _metal_seats(rng: np.random.Generator) -> Mesh:
    """Return two to four seats of sheet metal on a rail."""
    metal, skin = material("galvanised", "bench", rng), cloth("bench", rng)
    n, pitch = int(rng.integers(2, 5)), rng.uniform(0.5, 0.6)
    ys = (np.arange(n) - (n - 1) / 2) * pitch
    parts = [box([0.06, n * pitch, 0.06], [-0.05, 0, 0.36], metal)]
    turn = np.linspace(0.1, 0.55 * np.pi, 5)
    shell = np.concatenate([[[0.24, 0.43]], np.column_stack([-0.05 - 0.2 * np.sin(turn), 0.6 - 0.19 * np.cos(turn)])])
    shell = np.concatenate([shell, [[-0.3, 0.83]]])
    for y in ys:
        curve = np.stack(
            [np.column_stack([shell[:, 0], np.full(7, y + s * 0.22), shell[:, 1]]) for s in (1, -1)], axis=1
        )
        parts.append(loft(np.concatenate([curve, (curve - [0, 0, 0.02])[:, ::-1]], axis=1), skin))
    for y in (-0.35 * n * pitch, 0.35 * n * pitch):
        parts.append(box([0.06, 0.06, 0.36 + UNDERGROUND], [-0.05, y, (0.36 - UNDERGROUND) / 2], metal))
    return join(parts)


def _bollard(rng: np.random.Generator) -> Mesh:
    """Return a bollard of steel, iron, wood or concrete, its head flat, domed or a ball, with or without bands."""
    skin = material(str(rng.choice(["concrete", "painted_metal", "galvanised", "wood"])), "bollard", rng)
    radius, height, kind = rng.uniform(0.04, 0.13), rng.uniform(0.55, 1.1), int(rng.integers(4))
    taper, sides = rng.uniform(0.7, 1.0), int(rng.choice([4, 6, 8, 12]))
    profile = [[radius, -UNDERGROUND], [radius, 0.0], [taper * radius, height]]
    if kind == 0:
        profile.append([0, height])
    elif kind == 1:
        profile += [[0.7 * taper * radius, height + 0.5 * radius], [0, height + 0.7 * radius]]
    elif kind == 2:
        profile += [[0.5 * radius, height + 0.02], [1.0 * radius, height + radius], [0, height + 2 * radius]]
    else:
        profile = [[1.5 * radius, -UNDERGROUND], [1.5 * radius, 0.12], [radius, 0.16], *profile[2:],
                   [1.2 * taper * radius, height + 0.03], [0, height + 0.08]]  # fmt: skip
    parts = [lathe(profile, skin, sides=sides)]
    bands = ((), (0.8,), (0.68, 0.86))[int(rng.choice(3, p=[0.4, 0.35, 0.25]))]
    for z in bands:  # shares of the height
        shade = SIGN.white if rng.random() < 0.7 else SIGN.red
        band, wide = retroreflective(shade, "bollard", rng), radius * (1 + (taper - 1) * z) * 1.05
        parts.append(lathe([[wide, z * height - 0.03], [wide, z * height + 0.03]], band, sides=sides))
    return leaned(join(parts), rng, share=0.3)


def _flexible_post(rng: np.random.Generator) -> Mesh:
    """Return a slim plastic post between lanes with reflecting bands."""
    skin = tinted((0.55, 0.12, 0.03) if rng.random() < 0.6 else (0.05, 0.2, 0.08), "bollard", 0.35, rng)
    radius, height = rng.uniform(0.03, 0.05), rng.uniform(0.7, 1.1)
    foot = rng.uniform(0.09, 0.13)
    profile = [[foot, -0.05], [foot, 0.02], [radius, 0.05], [0.9 * radius, height], [0, height + radius]]
    parts = [lathe(profile, skin, sides=8)]
    for z in np.linspace(0.6, 0.85, int(rng.integers(1, 4))):
        band = retroreflective(SIGN.white, "bollard", rng)
        parts.append(lathe([[1.05 * radius, z * height - 0.04], [1.05 * radius, z * height + 0.04]], band, sides=8))
    return leaned(join(parts), rng, share=0.4)


def _hydrant(rng: np.random.Generator) -> Mesh:
    """Return a hydrant with bonnet, flanges, two hose outlets and one for the pump."""
    colour = [SIGN.red, SIGN.yellow, (0.05, 0.15, 0.45), (0.5, 0.5, 0.5)][int(rng.choice(4, p=[0.5, 0.3, 0.1, 0.1]))]
    skin, cap = tinted(colour, "hydrant", 0.35, rng), tinted((0.45, 0.46, 0.47), "hydrant", 0.4, rng, spread=0.4)
    height, radius = rng.uniform(0.58, 0.88), rng.uniform(0.085, 0.115)
    h, r = height, radius
    profile = [[1.55 * r, -0.1], [1.55 * r, 0.03], [1.15 * r, 0.04], [r, 0.12], [r, 0.68 * h], [1.35 * r, 0.7 * h],
               [1.35 * r, 0.75 * h], [1.1 * r, 0.77 * h], [0.8 * r, 0.9 * h], [0.3 * r, 0.95 * h], [0.3 * r, h],
               [0, h]]  # fmt: skip
    parts = [lathe(profile, skin, sides=12)]
    level = rng.uniform(0.5, 0.6) * h
    for yaw, wide in ((0.0, 0.65), (np.pi / 2, 0.5), (-np.pi / 2, 0.5)):
        nozzle = tube([[0.8 * r, 0, level], [1.6 * r, 0, level]], wide * r, skin, sides=8)
        lid = tube([[1.6 * r, 0, level], [1.8 * r, 0, level]], 1.15 * wide * r, cap, sides=6)
        parts.append(join([nozzle, lid]).moved([0, 0, 0], yaw=yaw))
    return leaned(join(parts), rng)


def _pillar_hydrant(rng: np.random.Generator) -> Mesh:
    """Return a slim tall hydrant with two outlets below its head."""
    skin = tinted(SIGN.red if rng.random() < 0.7 else (0.03, 0.1, 0.35), "hydrant", 0.35, rng)
    metal = tinted((0.5, 0.5, 0.5), "hydrant", 0.4, rng)
    height, r = rng.uniform(0.85, 1.2), rng.uniform(0.07, 0.1)
    profile = [[1.4 * r, -0.1], [1.4 * r, 0.06], [r, 0.1], [r, 0.85 * height], [1.2 * r, 0.87 * height],
               [0.9 * r, height], [0, 1.01 * height]]  # fmt: skip
    parts = [lathe(profile, skin, sides=12)]
    for side in (-1, 1):
        foot, tip = [0, side * 0.6 * r, 0.7 * height], [0.4 * r, side * 2.0 * r, 0.66 * height]
        parts.append(tube([foot, tip], 0.45 * r, metal, sides=8))
    return leaned(join(parts), rng)


def _cycle_rack(rng: np.random.Generator) -> Mesh:
    """Return two to five hoops side by side along y, round, square or slanting."""
    metal = material("galvanised" if rng.random() < 0.6 else "painted_metal", "other_object", rng)
    n, pitch, radius = int(rng.integers(2, 6)), rng.uniform(0.75, 1.05), rng.uniform(0.018, 0.03)
    half, height, lean = rng.uniform(0.3, 0.45), rng.uniform(0.7, 0.95), rng.normal(0, 0.06)
    f = np.linspace(0, np.pi, 9)
    corner = rng.uniform(1.0, 4.0)  # a superellipse: 1 is round, 4 nearly square
    x = half * np.sign(np.cos(f)) * np.abs(np.cos(f)) ** (1 / corner)
    z = height - half + half * np.sin(f) ** (1 / corner)
    path = np.column_stack([np.r_[half, x, -half], np.zeros(11), np.r_[-UNDERGROUND, z, -UNDERGROUND]])
    path[:, 1] = lean * np.maximum(path[:, 2], 0)
    return join([tube(path + np.array([0, (k - (n - 1) / 2) * pitch, 0]), radius, metal, sides=6) for k in range(n)])


def _planter(rng: np.random.Generator) -> Mesh:
    """Return a tub of concrete, wood or steel with soil and a low plant that has its own label."""
    skin = material(str(rng.choice(["concrete", "wood", "painted_metal", "stone"])), "other_object", rng)
    wide, long, height = rng.uniform([0.45, 0.45, 0.4], [0.9, 1.8, 0.8])
    round_one = rng.random() < 0.35
    flare = rng.uniform(0.7, 1.0)
    if round_one:
        long, turn = wide, np.arange(12) * np.pi / 6
        outline = wide / 2 * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    else:
        outline = np.column_stack([rounded(wide, long, 0.03), np.zeros(12)])
    inner = outline * [0.86, 0.86 if round_one else 1 - 0.14 * wide / long, 1]
    up = np.array([0.0, 0.0, 1.0])
    levels = [outline * [flare, flare, 1] - 0.05 * up, outline + height * up, inner + height * up,
              inner + (height - 0.08) * up]  # fmt: skip
    soil = tinted((0.1, 0.07, 0.05), "other_object", 0.25, rng)
    parts = [loft(levels, skin, closed=False)]
    parts.append(loft([inner + np.array([0, 0, height - 0.1]), inner + np.array([0, 0, height - 0.06])], soil))
    n, tall = int(rng.integers(60, 160)), rng.uniform(0.15, 0.7)
    place = rng.uniform(-0.45, 0.45, (n, 2)) * [wide, long]
    lift = tall * rng.random(n) * np.maximum(1 - (2 * np.abs(place) / [wide, long]).max(axis=1) ** 2, 0.2)
    centres = np.column_stack([place, height - 0.03 + lift])
    towards = np.column_stack([place / [wide, long], np.full(n, 0.4)]) + rng.normal(0, 0.2, (n, 3))
    leaf = material("leaf", "other_vegetation", rng)
    return join([*parts, leaves(centres, towards, rng.uniform(0.06, 0.14, n), rng.uniform(0.03, 0.07, n), leaf, rng)])


def _advertising_column(rng: np.random.Generator) -> Mesh:
    """Return a round column for posters under a cap."""
    base, metal = material("concrete", "other_object", rng), material("painted_metal", "other_object", rng)
    radius, height = rng.uniform(0.45, 0.72), rng.uniform(2.4, 3.5)
    foot, cap = rng.uniform(0.2, 0.5), rng.uniform(0.2, 0.6)
    parts = [lathe([[1.06, -0.1], [1.06, foot], [1.0, foot + 0.03]] * np.array([radius, 1.0]), base, sides=18)]
    for low, high in pairwise(np.linspace(foot + 0.03, height, int(rng.integers(2, 4)))):
        parts.append(lathe([[radius, low], [radius, high]], cloth("other_object", rng), sides=18))
    roof = [[1.15, height], [1.12, height + 0.1], [0.7, height + 0.6 * cap], [0.2, height + cap],
            [0, height + cap + 0.1]]  # fmt: skip
    return join([*parts, lathe(np.array(roof) * [radius, 1.0], metal, sides=18)])


def _poster_case(rng: np.random.Generator) -> Mesh:
    """Return a lit case for posters on one or two feet."""
    metal = material("painted_metal", "other_object", rng)
    width, tall, deep = rng.uniform(1.1, 1.4), rng.uniform(1.6, 2.0), rng.uniform(0.12, 0.25)
    low = rng.uniform(0.3, 0.8)
    case = np.column_stack([rounded(width, tall, 0.08), np.zeros(12)])[:, [2, 0, 1]] + [0, 0, low + tall / 2]
    parts = [loft([case + np.array([deep / 2, 0, 0]), case - [deep / 2, 0, 0]], metal)]
    for x in (-1, 1):
        poster = cloth("other_object", rng)
        parts.append(
            panel(rectangle(0.88 * width, 0.9 * tall), poster, poster, [x * (deep / 2 + 0.004), 0, low + tall / 2])
        )
    for y in (0.0,) if rng.random() < 0.5 else (-0.3 * width, 0.3 * width):
        parts.append(box([0.7 * deep, 0.2, low + UNDERGROUND], [0, y, (low - UNDERGROUND) / 2], metal))
    return join(parts)


def _cone(rng: np.random.Generator) -> Mesh:
    """Return a traffic cone."""
    skin, band = tinted((0.6, 0.13, 0.02), "other_object", 0.4, rng), retroreflective(SIGN.white, "other_object", rng)
    height, r = rng.uniform(0.45, 0.95), rng.uniform(0.12, 0.17)
    parts = [box([2.5 * r, 2.5 * r, 0.04], [0, 0, 0.02], skin), lathe([[r, 0.04], [0.02, height], [0, height]], skin)]
    for f in (0.35, 0.65)[: int(rng.integers(1, 3))]:
        low, high = f * height, (f + 0.16) * height
        wide = [r + (0.02 - r) * (z - 0.04) / (height - 0.04) + 0.003 for z in (low, high)]
        parts.append(lathe([[wide[0], low], [wide[1], high]], band))
    return join(parts)


DESIGNS: tuple[Design, ...] = (
    Design("wheelie_bin", "bin", bins.wheelie_bin, clearance=0.5, weight=1.5),
    Design("large_container", "bin", bins.large_container, clearance=0.9, weight=0.6),
    Design("litter_bin", "bin", bins.litter_bin, clearance=0.5, weight=1.5),
    Design("post_bin", "bin", bins.post_bin, clearance=0.5, weight=1.5),
    Design("bottle_bank", "bin", bins.bottle_bank, clearance=1.1, weight=0.4),
    Design("slatted_bench", "bench", _bench, clearance=1.2, weight=2.0),
    Design("block_bench", "bench", _block_bench, clearance=1.3, weight=0.6),
    Design("metal_seats", "bench", _metal_seats, clearance=1.3, weight=0.6),
    Design("bollard", "bollard", _bollard, clearance=0.3, weight=3.0),
    Design("flexible_post", "bollard", _flexible_post, clearance=0.3),
    Design("hydrant", "hydrant", _hydrant, clearance=0.4),
    Design("pillar_hydrant", "hydrant", _pillar_hydrant, clearance=0.4, weight=0.7),
    Design("mail_box", "mail_box", bins.mail_box, clearance=0.5),
    Design("pillar_box", "mail_box", bins.pillar_box, clearance=0.5, weight=0.6),
    Design("parking_meter", "parking_meter", bins.parking_meter, clearance=0.3),
    Design("pay_station", "parking_meter", bins.pay_station, clearance=0.4, weight=0.7),
    Design("cycle_rack", "other_object", _cycle_rack, clearance=2.3),
    Design("planter", "other_object", _planter, clearance=1.1),
    Design("cabinet", "other_object", bins.cabinet, clearance=1.0, weight=1.5),
    Design("advertising_column", "other_object", _advertising_column, clearance=0.9, weight=0.4),
    Design("poster_case", "other_object", _poster_case, clearance=0.9, weight=0.5),
    Design("traffic_cone", "other_object", _cone, clearance=0.4, weight=0.3),
)
