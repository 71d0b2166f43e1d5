"""Street lamps: arms reach along +x over the road, and their signs face +y.

Heights are those of lighting practice: 3 to 5 m for post tops, 5 to 12 m beside roads, 14 to 24 m for high masts.
"""

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.model.materials import cloth, material
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, ellipsoid, tube
from mlsroad_pipeline.simulation.objects.parts import (
    UNDERGROUND,
    arm,
    ballast,
    banner,
    lathe,
    leaned,
    luminaire,
    mast,
    metal,
    tinted,
)
from mlsroad_pipeline.simulation.objects.traffic_signs import sign_plate


def _shaft(rng: np.random.Generator, low: float, high: float) -> tuple[list[Mesh], float, float, Surface]:
    """Return a mast, its height, its radius at the ground and its surface."""
    height = rng.uniform(low, high)
    radius = rng.uniform(0.05, 0.09) + 0.006 * height
    surface = metal("light_pole", rng)
    parts = [mast(rng, height, radius, surface)]
    if rng.random() < 0.12:
        parts.append(ballast(rng, [-0.7 * radius, 0, rng.uniform(1.6, 4.0)], surface))
    return parts, height, radius, surface


def _armed(rng: np.random.Generator, top: float, surface: Surface, reach: float, *, low: float = 0.0) -> list[Mesh]:
    """Return an arm with its luminaire; some arms have a stay."""
    rise, bend, thick = rng.uniform(0.05, 0.6), float(rng.choice([0.0, 1.0])), rng.uniform(0.025, 0.04)
    start = np.array([0, 0, top - 0.08 - low])
    end = start + np.array([reach, 0, rise])
    head = luminaire(rng, end, surface, pitch=rng.uniform(0, 0.2))
    parts = [arm(start, reach, rise, bend, surface, thick), head]
    if rng.random() < 0.25 and reach > 1.2:
        stay = [start + np.array([0, 0, -0.5]), start + np.array([0.6 * reach, 0, 0.55 * rise])]
        parts.append(tube(stay, 0.012, surface, sides=4))
    return parts


def _single_arm(rng: np.random.Generator) -> Mesh:
    parts, height, _, surface = _shaft(rng, 5.5, 11.5)
    return leaned(join([*parts, *_armed(rng, height, surface, rng.uniform(0.4, 2.8))]), rng)


def _double_arm(rng: np.random.Generator) -> Mesh:
    parts, height, _, surface = _shaft(rng, 6.0, 12.0)
    reach, same = rng.uniform(0.5, 2.4), rng.random() < 0.75
    # A lower second arm lights the pavement.
    low, back = (0.0, reach) if same else (rng.uniform(1.5, 0.35 * height), reach * rng.uniform(0.4, 0.8))
    behind = join(_armed(rng, height, surface, back, low=low)).moved([0, 0, 0], yaw=np.pi)
    return leaned(join([*parts, *_armed(rng, height, surface, reach), behind]), rng)


def _curved_arm(rng: np.random.Generator) -> Mesh:
    """Return a mast that bends over into its own arm."""
    surface = metal("light_pole", rng)
    height, reach = rng.uniform(5.5, 11.0), rng.uniform(0.8, 2.6)
    radius = rng.uniform(0.05, 0.085) + 0.006 * height
    bow, droop = rng.uniform(0.6, 1.6), rng.uniform(np.radians(75), np.radians(120))
    f = np.linspace(0, droop, 10)
    wide = reach / (1 - np.cos(droop))
    curve = np.column_stack([wide * (1 - np.cos(f)), 0 * f, height - bow + bow * np.sin(f)])
    path = np.concatenate([[[0, 0, -UNDERGROUND], [0, 0, 0.5 * (height - bow)]], curve])
    radii = np.concatenate([[radius, 0.85 * radius], np.linspace(0.7 * radius, 0.03, 10)])
    parts = [tube(path, radii, surface, sides=8), box([4 * radius, 4 * radius, 0.12], [0, 0, -0.04], surface)]
    if rng.random() < 0.4:
        sleeve = [[1.35 * radius, -0.1], [1.35 * radius, rng.uniform(0.8, 1.6)], [radius, 1.75]]
        parts.append(lathe(sleeve, surface, sides=8))
    return leaned(join([*parts, luminaire(rng, path[-1], surface, pitch=min(np.pi / 2 - droop, 0.0))]), rng)


def _lantern(
    rng: np.random.Generator, at: NDArray[np.float64], iron: Surface, glass: Surface, sides: int
) -> list[Mesh]:
    size, tall = rng.uniform(0.13, 0.2), rng.uniform(0.35, 0.55)
    panes = [[0.6 * size, 0.06], [size, tall]]
    roof = [[1.15 * size, tall], [0.9 * size, tall + 0.08], [0.3 * size, tall + 0.2], [0.05, tall + 0.32],
            [0, tall + 0.4]]  # fmt: skip
    parts = [lathe(panes, glass, at=at, sides=sides), lathe(roof, iron, at=at, sides=sides)]
    parts.append(lathe([[0.0, 0.0], [0.6 * size, 0.02], [0.65 * size, 0.06]], iron, at=at, sides=sides))
    for k in range(sides):
        turn = 2 * np.pi * k / sides
        ray = np.array([np.cos(turn), np.sin(turn), 0])
        rails = at + np.array([0.6 * size * ray + [0, 0, 0.06], size * ray + [0, 0, tall]])
        parts.append(tube(rails, 0.012, iron, sides=3))
    bulb = tinted((0.7, 0.68, 0.6), "light_pole", 0.5, rng)
    parts.append(ellipsoid(at + np.array([0, 0, 0.5 * tall]), [0.05, 0.05, 0.12], bulb, rings=2, sides=5))
    return parts


def _heritage_lantern(rng: np.random.Generator) -> Mesh:
    """Return a turned iron column with one lantern on top or two to four on brackets."""
    iron = tinted((0.03, 0.04, 0.035), "light_pole", 0.18, rng, spread=0.3)
    glass = material("glass", "light_pole", rng)
    height, foot = rng.uniform(2.8, 4.4), rng.uniform(0.14, 0.24)
    base, shaft = rng.uniform(0.5, 1.0), rng.uniform(0.045, 0.07)
    profile = [
        [foot, -UNDERGROUND], [foot, 0.15], [0.75 * foot, 0.22], [0.7 * foot, base], [0.85 * foot, base + 0.05],
        [1.3 * shaft, base + 0.15], [shaft, 0.6 * height], [1.35 * shaft, 0.62 * height], [0.85 * shaft, 0.66 * height],
        [0.75 * shaft, height - 0.1], [1.6 * shaft, height - 0.03], [0.6 * shaft, height],
    ]  # fmt: skip
    parts = [lathe(profile, iron, sides=10)]
    count = int(rng.choice([0, 2, 3, 4], p=[0.55, 0.3, 0.1, 0.05]))
    sides = int(rng.choice([4, 6, 8])) if count == 0 else 4 if count > 2 else int(rng.choice([4, 6]))
    if count == 0 or (count < 4 and rng.random() < 0.4):
        parts += _lantern(rng, np.array([0, 0, height]), iron, glass, sides)
    reach, start = rng.uniform(0.35, 0.6), rng.uniform(0, np.pi / 2) if count > 2 else 0.0
    f = np.linspace(0, np.pi, 7)
    for k in range(count):
        turn = start + 2 * np.pi * k / count
        ray = np.array([np.cos(turn), np.sin(turn), 0.0])
        lift = height - 0.5 + np.column_stack([0.22 * np.sin(f)])
        path = (reach * f / np.pi)[:, None] * ray + lift * [0, 0, 1]
        parts.append(tube(path, 0.02, iron, sides=3))
        parts += _lantern(rng, path[-1], iron, glass, sides)
    return leaned(join(parts), rng)


def _banner_lamp(rng: np.random.Generator) -> Mesh:
    parts, height, radius, surface = _shaft(rng, 5.5, 10.5)
    fabric = cloth("light_pole", rng)
    low = rng.uniform(2.4, 0.55 * height)
    for side in (-1, 1) if rng.random() < 0.4 else (int(rng.choice([-1, 1])),):
        parts.append(banner(rng, low, 0.8 * radius, side, fabric, surface))
    return leaned(join([*parts, *_armed(rng, height, surface, rng.uniform(0.4, 2.4))]), rng)


def _lamp_with_sign(rng: np.random.Generator) -> Mesh:
    """Return a lamp with one to three plates, labelled as signs."""
    parts, height, radius, surface = _shaft(rng, 5.5, 11.0)
    parts += _armed(rng, height, surface, rng.uniform(0.4, 2.6))
    bottom = rng.uniform(2.0, 2.8)
    for _ in range(int(rng.choice([1, 2, 3], p=[0.65, 0.25, 0.1]))):
        plate, half = sign_plate(rng)
        yaw = np.pi / 2 * (1 if rng.random() < 0.8 else -1) + rng.normal(0, 0.1)
        out = radius + rng.uniform(0.03, 0.1)
        parts.append(plate.moved([out * np.cos(yaw), out * np.sin(yaw), bottom + half], yaw=yaw))
        parts.append(box([2.2 * radius, 2.4 * radius, 0.03], [0, 0, bottom + half], surface))
        bottom += 2 * half + rng.uniform(0.02, 0.1)
    return leaned(join(parts), rng)


def _post_top(rng: np.random.Generator) -> Mesh:
    """Return a short mast with a globe, a cylinder, a mushroom or a disc of diodes on top."""
    surface = metal("light_pole", rng)
    height, radius = rng.uniform(2.9, 5.2), rng.uniform(0.045, 0.08)
    lens = tinted((0.65, 0.65, 0.62), "light_pole", 0.5, rng)
    parts, top = [mast(rng, height, radius, surface)], np.array([0, 0, height])
    size, kind = rng.uniform(0.15, 0.28), int(rng.integers(4))
    if kind == 0:
        parts.append(
            ellipsoid(top + np.array([0, 0, 0.8 * size]), [size, size, size * rng.uniform(0.8, 1.2)], lens, sides=10)
        )
    elif kind == 1:
        tall = rng.uniform(0.4, 0.8)
        parts.append(lathe([[0.7 * size, 0], [0.7 * size, tall]], lens, at=top, sides=10))
        parts.append(lathe([[1.1 * size, tall], [0.9 * size, tall + 0.06], [0, tall + 0.09]], surface, at=top))
    elif kind == 2:
        parts.append(lathe([[0.35 * size, 0], [0.6 * size, 0.3]], lens, at=top, sides=10))
        parts.append(lathe([[1.7 * size, 0.27], [0.9 * size, 0.4], [0, 0.46]], surface, at=top, sides=12))
    else:
        disc = [[0, 0.25], [1.4 * size, 0.25], [1.4 * size, 0.31], [0.2 * size, 0.36], [0, 0.36]]
        parts.append(lathe(disc, surface, at=top, sides=14))
        for k in range(3):
            turn = 2 * np.pi * k / 3
            rod = size * np.array([np.cos(turn), np.sin(turn), 0])
            parts.append(tube([top, top + rod + [0, 0, 0.26]], 0.012, surface, sides=4))
    return leaned(join(parts), rng)


def _high_mast(rng: np.random.Generator) -> Mesh:
    height, surface = rng.uniform(14, 24), material("galvanised", "light_pole", rng)
    radius = 0.1 + 0.008 * height
    parts = [lathe([[radius, -UNDERGROUND], [0.35 * radius, height], [0, height + 0.1]], surface, sides=12),
             lathe([[1.7 * radius, -0.1], [1.7 * radius, 0.05], [radius, 0.05]], surface, sides=12)]  # fmt: skip
    ring, count = rng.uniform(0.7, 1.1), int(rng.integers(3, 9))
    turn = np.linspace(0, 2 * np.pi, 13)
    circle = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), np.full(13, height - 0.4)])
    parts.append(tube(circle, 0.04, surface, sides=4))
    glass = tinted((0.6, 0.6, 0.58), "light_pole", 0.45, rng)
    for k in range(count):
        yaw = 2 * np.pi * k / count
        spot = join([box([0.35, 0.5, 0.3], [ring + 0.15, 0, -0.45], surface),
                     box([0.03, 0.42, 0.24], [ring + 0.33, 0, -0.45], glass),
                     tube([[0, 0, -0.4], [ring, 0, -0.4]], 0.03, surface, sides=4)])  # fmt: skip
        parts.append(spot.moved([0, 0, height], yaw=yaw))
    return leaned(join(parts), rng, share=0.05, limit=1.0)


DESIGNS: tuple[Design, ...] = (
    Design("single_arm_lamp", "light_pole", _single_arm, 0.5, 4.0),
    Design("double_arm_lamp", "light_pole", _double_arm, 0.5, 1.5),
    Design("curved_arm_lamp", "light_pole", _curved_arm, 0.5, 2.0),
    Design("heritage_lantern", "light_pole", _heritage_lantern, 0.5, 1.0),
    Design("banner_lamp", "light_pole", _banner_lamp, 1.0, 1.2),
    Design("lamp_with_sign", "light_pole", _lamp_with_sign, 0.7, 1.5),
    Design("post_top_lamp", "light_pole", _post_top, 0.5, 1.5),
    Design("high_mast", "light_pole", _high_mast, 0.7, 0.1),
)
