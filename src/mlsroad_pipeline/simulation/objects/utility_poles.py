"""Utility poles: cross-arms along x, so that wires run along y; every pole has the same number of wires.

Poles are 7.5 to 12 m high and 0.2 to 0.4 m thick at the ground, as in low and medium voltage lines.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.materials import material
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, tube
from mlsroad_pipeline.simulation.objects.parts import UNDERGROUND, arm, lathe, leaned, luminaire, tinted
from mlsroad_pipeline.simulation.objects.traffic_signs import sign_plate

WIRES = 6  # Wires of each pole: four conductors, a low-voltage bundle, a telephone cable
Hung = tuple[Mesh, NDArray[np.float64]]


def _shaft(rng: np.random.Generator, kind: str) -> tuple[list[Mesh], float, float, Surface]:
    """Return a pole of wood, round or square concrete, or steel, its height, its radius at the ground and its skin."""
    height, radius = rng.uniform(7.8, 11.5), rng.uniform(0.11, 0.16)
    if kind == "wood":
        skin = material("wood", "utility_pole", rng)
        bow = rng.normal(0, 0.03, 2)
        f = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
        path = np.column_stack([bow[0] * np.sin(np.pi * f), bow[1] * np.sin(np.pi * f), height * f])
        path = np.concatenate([[[0, 0, -UNDERGROUND]], path])
        parts = [tube(path, np.concatenate([[radius], radius * (1 - rng.uniform(0.25, 0.4) * f)]), skin, sides=10)]
    else:
        skin = material("concrete" if kind == "concrete" else "galvanised", "utility_pole", rng)
        sides = int(rng.choice([4, 8, 12])) if kind == "concrete" else 12
        radius *= rng.uniform(1.0, 1.3)
        top = radius * rng.uniform(0.5, 0.7)
        parts = [lathe([[radius, -UNDERGROUND], [radius, 0], [top, height], [0, height]], skin, sides=sides)]
    if rng.random() < 0.3:  # number plate or warning plate
        tin = tinted((0.6, 0.5, 0.1), "utility_pole", 0.45, rng, spread=0.4)
        parts.append(box([0.01, 0.12, 0.18], [radius + 0.005, 0, rng.uniform(1.6, 2.3)], tin))
    if rng.random() < 0.25:  # cable down to the ground in a pipe
        pipe = tinted((0.25, 0.26, 0.26), "utility_pole", 0.3, rng, spread=0.3)
        turn = rng.uniform(0, 2 * np.pi)
        at = (radius + 0.02) * np.array([np.cos(turn), np.sin(turn)])
        foot, head = [at[0], at[1], -0.1], [0.8 * at[0], 0.8 * at[1], rng.uniform(2.5, 0.7 * height)]
        parts.append(tube([foot, head], rng.uniform(0.02, 0.045), pipe, sides=5))
    return parts, height, radius, skin


def _insulator(at: NDArray[np.float64], tall: float, skin: Surface) -> Mesh:
    profile = [[0.02, 0], [0.02, 0.3 * tall], [0.05, 0.45 * tall], [0.035, 0.75 * tall], [0.045, 0.85 * tall],
               [0, tall]]  # fmt: skip
    return lathe(profile, skin, at=at, sides=6)


def _cross_arm(
    rng: np.random.Generator, level: float, xs: NDArray[np.float64], skin: Surface, at: float
) -> tuple[list[Mesh], list[NDArray[np.float64]]]:
    """Return a cross-arm in front of the pole with pin insulators, and the tops of these."""
    metal = material("galvanised", "utility_pole", rng)
    ceramic = tinted((0.25, 0.12, 0.06), "utility_pole", 0.3, rng, spread=0.5)
    ends = np.array([xs.min() - 0.1, xs.max() + 0.1])
    thick = rng.uniform(0.08, 0.12)
    parts = [box([np.ptp(ends), thick, thick], [ends.mean(), at, level], skin)]
    tall, tops = rng.uniform(0.16, 0.28), []
    for x in xs:
        foot = np.array([x, at, level + thick / 2])
        parts.append(_insulator(foot, tall, ceramic))
        tops.append(foot + np.array([0, 0, tall]))
    if rng.random() < 0.7:  # flat braces
        for side in (-1, 1):
            parts.append(tube([[0, at, level - 0.45], [0.45 * side, at, level - 0.04]], 0.012, metal, sides=3))
    return parts, tops


def _low_lines(rng: np.random.Generator, height: float, radius: float) -> tuple[list[Mesh], list[NDArray[np.float64]]]:
    """Return the clamps of the low-voltage bundle and of the telephone cable on the road side."""
    metal = material("galvanised", "utility_pole", rng)
    parts, points = [], []
    for below in (rng.uniform(1.6, 2.2), rng.uniform(2.6, 3.4)):
        at = np.array([0.95 * radius + 0.05, 0.0, height - below])
        parts.append(box([0.16, 0.05, 0.06], at - [0.08, 0, 0], metal))
        points.append(at)
    return parts, points


def _finished(parts: list[Mesh], points: list[NDArray[np.float64]], rng: np.random.Generator) -> Hung:
    """Return pole and attachment points, leaned together."""
    order = np.argsort([point[0] for point in points[:4]], kind="stable")
    markers = np.concatenate([np.array(points[:4])[order], points[4:]])
    nothing = np.zeros((0, 3), dtype=np.int64), np.zeros((0, 6), dtype=np.float32)
    body = join(parts)
    n = len(body.vertices)
    leant = leaned(join([body, Mesh(markers, *nothing)]), rng)
    return Mesh(leant.vertices[:n], leant.faces, leant.attributes), leant.vertices[n:].copy()


def _line_pole(rng: np.random.Generator, *, kind: str, levels: int, extra: str = "") -> Hung:
    parts, height, radius, skin = _shaft(rng, kind)
    steel = skin if kind == "wood" else material("galvanised", "utility_pole", rng)
    reach, front = rng.uniform(0.7, 1.15), 0.75 * radius + 0.05
    if levels == 1:
        rows = [(0.25, np.array([-reach, -0.4 * reach, 0.4 * reach, reach]))]
    else:
        rows = [(0.25, np.array([-reach, reach])), (rng.uniform(0.8, 1.2), np.array([-0.75, 0.75]) * reach)]
    points: list[NDArray[np.float64]] = []
    for below, xs in rows:
        arms, tops = _cross_arm(rng, height - below, xs, steel, front)
        parts += arms
        points += tops
    clamps, low = _low_lines(rng, height, radius)
    parts += clamps
    if extra == "transformer":
        parts += _transformer(rng, height, radius)
    elif extra == "lamp":
        parts += _street_lamp(rng, height, radius)
    if rng.random() < 0.1:
        plate, half = sign_plate(rng)
        parts.append(plate.moved([0, radius + 0.04, rng.uniform(2.0, 2.5) + half], yaw=np.pi / 2))
    return _finished(parts, [*points, *low], rng)


def _transformer(rng: np.random.Generator, height: float, radius: float) -> list[Mesh]:
    """Return one tank, or a row of three, with bushings."""
    tank = Surface(TAXONOMY["transformer"], (0.3, 0.31, 0.32), float(rng.uniform(0.25, 0.45)))
    size, tall, level = rng.uniform(0.2, 0.3), rng.uniform(0.75, 1.1), height - rng.uniform(2.6, 3.4)
    parts = []
    for turn in (np.pi,) if rng.random() < 0.75 else (np.pi / 2, np.pi, 3 * np.pi / 2):
        out = radius + size + 0.08
        at = np.array([out * np.cos(turn), out * np.sin(turn), level])
        can = [[0.0, 0.0], [size, 0.0], [size, 0.9 * tall], [1.05 * size, 0.92 * tall], [0.9 * size, tall], [0.0, tall]]
        parts.append(lathe(can, tank, at=at, sides=12))
        for side in (-0.4, 0.4):
            parts.append(
                lathe([[0.03, 0], [0.05, 0.1], [0, 0.2]], tank, at=at + np.array([side * size, 0, tall]), sides=5)
            )
        parts.append(box([0.14, 0.14, 0.1], at * [0.45, 0.45, 1] + [0, 0, 0.6 * tall], tank))
    return parts


def _street_lamp(rng: np.random.Generator, height: float, radius: float) -> list[Mesh]:
    """Return an arm with a luminaire, which has its own label."""
    steel = material("galvanised", "light_pole", rng)
    start, reach = np.array([0.7 * radius, 0, height * rng.uniform(0.55, 0.75)]), rng.uniform(0.8, 2.2)
    rise = rng.uniform(0.1, 0.6)
    head = luminaire(rng, start + np.array([reach, 0, rise]), steel, pitch=rng.uniform(0, 0.15))
    return [arm(start, reach, rise, float(rng.choice([0.0, 1.0])), steel, 0.03), head]


def _rack_pole(rng: np.random.Generator) -> Hung:
    """Return a low-voltage pole: four conductors one above the other on spools at its side."""
    parts, height, radius, _ = _shaft(rng, str(rng.choice(["wood", "concrete", "steel"])))
    ceramic = tinted((0.5, 0.48, 0.45), "utility_pole", 0.4, rng, spread=0.3)
    metal = material("galvanised", "utility_pole", rng)
    gap, top = rng.uniform(0.2, 0.32), height - rng.uniform(0.2, 0.5)
    out = radius + 0.06
    parts.append(box([0.03, 0.06, 3 * gap + 0.2], [radius - 0.02, 0, top - 1.5 * gap], metal))
    points = []
    for k in range(4):
        at = np.array([out, 0, top - k * gap])
        parts.append(lathe([[0, -0.04], [0.045, -0.04], [0.03, 0], [0.045, 0.04], [0, 0.04]], ceramic, at=at, sides=8))
        parts.append(box([0.08, 0.03, 0.015], at - [0.04, 0, 0.055], metal))
        points.append(at + np.array([0.03, 0, 0]))
    clamps, low = _low_lines(rng, height, radius)
    if rng.random() < 0.4:
        parts += _street_lamp(rng, height, radius)
    return _finished([*parts, *clamps], [*points, *low], rng)


def _concrete_pole(rng: np.random.Generator) -> Hung:
    """Return a pole with three conductors on brackets in a triangle and an earth wire on the tip."""
    parts, height, radius, _ = _shaft(rng, "concrete" if rng.random() < 0.7 else "steel")
    metal = material("galvanised", "utility_pole", rng)
    ceramic = tinted((0.4, 0.4, 0.42), "utility_pole", 0.35, rng, spread=0.4)
    reach, tall = rng.uniform(0.5, 0.9), rng.uniform(0.2, 0.35)
    points = []
    for x, below in ((-reach, 0.9), (-0.8 * reach, 0.35), (0.8 * reach, 0.35), (reach, 0.9)):
        foot = np.array([x, 0.0, height - below])
        parts.append(tube(np.array([foot * [0, 0, 1] - [0, 0, 0.12], foot]), 0.03, metal, sides=4))
        parts.append(_insulator(foot, tall, ceramic))
        points.append(foot + np.array([0, 0, tall]))
    clamps, low = _low_lines(rng, height, radius)
    if rng.random() < 0.2:
        parts += _transformer(rng, height, radius)
    return _finished([*parts, *clamps], [*points, *low], rng)


_HUNG: dict[str, Callable[[np.random.Generator], Hung]] = {
    "wood_pole": partial(_line_pole, kind="wood", levels=1),
    "double_cross_arm_pole": partial(_line_pole, kind="wood", levels=2),
    "concrete_line_pole": partial(_line_pole, kind="concrete", levels=2),
    "bracket_pole": _concrete_pole,
    "rack_pole": _rack_pole,
    "transformer_pole": partial(_line_pole, kind="wood", levels=2, extra="transformer"),
    "utility_pole_with_lamp": partial(_line_pole, kind="wood", levels=1, extra="lamp"),
}
_WEIGHTS = {"transformer_pole": 0.4, "utility_pole_with_lamp": 0.6}


def hung_pole(name: str, rng: np.random.Generator) -> Hung:
    """Return a pole, as the design of a name builds it from the same stream, and the attachment points of its wires.

    The points, (WIRES, 3) metres, are four conductors by their x, the bundle of low voltage, and the telephone cable.
    The k-th wire runs from the k-th point of a pole to the k-th of the next one, of whatever design.
    """
    return _HUNG[name](rng)


def _built(name: str, rng: np.random.Generator) -> Mesh:
    return _HUNG[name](rng)[0]


DESIGNS: tuple[Design, ...] = tuple(
    Design(name, "utility_pole", partial(_built, name), clearance=0.6, weight=_WEIGHTS.get(name, 1.0)) for name in _HUNG
)
