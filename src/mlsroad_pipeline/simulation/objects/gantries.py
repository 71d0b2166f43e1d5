"""Gantries for direction boards: beams along +x over the road, boards facing +y, at least 5 m above the ground."""

from itertools import pairwise

import numpy as np

from mlsroad_pipeline.simulation.model.materials import SIGN, material
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, tube
from mlsroad_pipeline.simulation.objects.parts import UNDERGROUND, lathe
from mlsroad_pipeline.simulation.objects.traffic_signs import board


def _beam(rng: np.random.Generator, x: tuple[float, float], level: float, metal: Surface) -> list[Mesh]:
    """Return a box beam, a tube, or a lattice of four chords with diagonals."""
    start, end = x
    kind = int(rng.integers(3))
    if kind == 0:
        tall = rng.uniform(0.3, 0.55)
        return [box([end - start, rng.uniform(0.3, 0.5), tall], [(start + end) / 2, 0, level + tall / 2], metal)]
    if kind == 1:
        radius = rng.uniform(0.09, 0.16)
        return [tube([[start, 0, level + z], [end, 0, level + z]], radius, metal) for z in (radius, 5 * radius)]
    deep, tall, panels = rng.uniform(0.4, 0.7), rng.uniform(0.5, 0.9), max(int((end - start) / 1.6), 2)
    parts = []
    for y in (-deep / 2, deep / 2):
        parts += [tube([[start, y, z], [end, y, z]], 0.05, metal, sides=4) for z in (level, level + tall)]
        nodes = np.linspace(start, end, panels + 1)
        zigzag = np.column_stack([nodes, np.full(panels + 1, y), level + tall * (np.arange(panels + 1) % 2)])
        parts.append(tube(zigzag, 0.03, metal, sides=3))
    for z in (level, level + tall):
        nodes = np.linspace(start, end, panels + 1)
        across = np.column_stack([nodes, deep * (np.arange(panels + 1) % 2 - 0.5), np.full(panels + 1, z)])
        parts.append(tube(across, 0.025, metal, sides=3))
    return parts


def _leg(rng: np.random.Generator, x: float, height: float, metal: Surface, radius: float, sides: int) -> list[Mesh]:
    profile = [[radius, -UNDERGROUND], [0.75 * radius, height], [0, height]]
    plinth = radius * rng.uniform(1.8, 2.6)
    concrete = material("concrete", "gantry", rng)
    foot = box([2 * plinth, 2 * plinth, UNDERGROUND + 0.15], [x, 0, (0.15 - UNDERGROUND) / 2], concrete)
    return [lathe(profile, metal, at=[x, 0, 0], sides=sides), foot]


def _boards(rng: np.random.Generator, x: tuple[float, float], level: float, count: int) -> list[Mesh]:
    """Return boards side by side along the beam, held by brackets."""
    colour = SIGN.blue if rng.random() < 0.5 else SIGN.green
    slots = np.linspace(x[0], x[1], count + 1)
    parts = []
    for a, b in pairwise(slots):
        width, tall = (b - a) * rng.uniform(0.7, 0.92), rng.uniform(1.2, 2.6)
        middle = [(a + b) / 2, 0.42, level + tall / 2 - 0.25]
        parts.append(board(rng, width, tall, colour, middle, np.pi / 2))
    return parts


def gantry(rng: np.random.Generator, span: float) -> Mesh:
    """Return a gantry over the whole road, with legs at 0 and at `span` metres; its boards are `traffic_sign`."""
    metal = material("galvanised" if rng.random() < 0.7 else "painted_metal", "gantry", rng)
    level, radius, sides = rng.uniform(5.4, 6.6), rng.uniform(0.14, 0.24), int(rng.choice([4, 8, 12]))
    parts = _beam(rng, (-0.3, span + 0.3), level, metal)
    for x in (0.0, span):
        parts += _leg(rng, x, level + rng.uniform(0.2, 0.7), metal, radius, sides)
    low = rng.uniform(0.12, 0.3) * span
    high = span - rng.uniform(0.12, 0.3) * span
    return join([*parts, *_boards(rng, (low, high), level, max(int((high - low) / rng.uniform(3.0, 4.5)), 1))])


def _over_the_road(rng: np.random.Generator) -> Mesh:
    return gantry(rng, rng.uniform(11.0, 22.0))


def _cantilever(rng: np.random.Generator) -> Mesh:
    """Return one leg with one arm over the nearest lanes."""
    metal = material("galvanised" if rng.random() < 0.7 else "painted_metal", "gantry", rng)
    level, reach = rng.uniform(5.4, 6.4), rng.uniform(3.5, 7.5)
    parts = _leg(rng, 0.0, level + 1.0, metal, rng.uniform(0.16, 0.26), int(rng.choice([4, 8, 12])))
    parts += _beam(rng, (-0.2, reach), level, metal)
    return join([*parts, *_boards(rng, (reach * rng.uniform(0.15, 0.35), reach), level, int(rng.integers(1, 3)))])


DESIGNS: tuple[Design, ...] = (
    Design("sign_gantry", "gantry", _over_the_road, 0.8),
    Design("cantilever_gantry", "gantry", _cantilever, 0.8, 1.5),
)
