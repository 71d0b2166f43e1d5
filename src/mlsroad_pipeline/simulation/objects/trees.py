"""Broadleaf trees of all habits, young with stakes, bare in winter; spruces, pines, cedars, cypresses, small cones.

Measures follow common tables of street and park trees: broadleaf ones 6 to 15 m high, mature to 20, crowns of 3 to
12 m, stems of 0.1 to 0.6 m at breast height, the first limb above 1.8 m over pavements. Spruces are 5 to 15 m high and
0.3 to 0.45 times as wide, pines 6 to 14 m with the crown in the upper half, cypresses 4 to 12 m and 0.12 to 0.22 times
as wide, with stems of 1.6 to 2.6 % of the height.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from mlsroad_pipeline.simulation.model.materials import bark, foliage, same_as
from mlsroad_pipeline.simulation.model.meshes import DIFFUSE, Design, Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import Floats, bearing, blades, lift, tubes, unit
from mlsroad_pipeline.simulation.plants.crowns import UNDERGROUND, Colours, Habit, Outline, grow_tree

_ROUND = Habit(
    height=(6.0, 13.0), width=(0.52, 0.78), clear=(0.2, 0.32), profile=(0.5, 0.5), leader=(0.35, 0.6),
    rise=(0.35, 0.95), girth=(18, 26), limbs=(9, 13), droop=(0.0, 0.3), density=(0.8, 1.5), clump=(0.2, 0.36),
)  # fmt: skip
_MATURE = replace(
    _ROUND, height=(13.0, 20.0), width=(0.42, 0.6), clear=(0.16, 0.28), profile=(0.45, 0.5), leader=(0.6, 0.85),
    limbs=(12, 16), density=(0.7, 1.2), clump=(0.25, 0.42),
)  # fmt: skip
_COLUMNAR = replace(
    _ROUND, height=(7.0, 15.0), width=(0.2, 0.32), clear=(0.1, 0.2), profile=(0.3, 0.4), leader=(0.85, 0.95),
    rise=(0.95, 1.25), girth=(10, 14), limbs=(12, 15), density=(1.1, 1.8), clump=(0.16, 0.26),
)  # fmt: skip
_VASE = replace(
    _ROUND, height=(7.0, 14.0), width=(0.6, 0.85), clear=(0.16, 0.26), profile=(0.95, 0.3), leader=(0.1, 0.3),
    rise=(0.75, 1.15), limbs=(8, 11), droop=(0.0, 0.5),
)  # fmt: skip
_PYRAMID = replace(
    _ROUND, height=(7.0, 14.0), width=(0.38, 0.55), clear=(0.17, 0.27), profile=(0.3, 0.85), leader=(0.8, 0.95),
    rise=(0.25, 0.7), girth=(14, 20), limbs=(11, 15),
)  # fmt: skip
_WEEPING = replace(
    _ROUND, height=(5.0, 10.0), width=(0.8, 1.05), clear=(0.24, 0.34), profile=(0.8, 0.5), leader=(0.5, 0.75),
    rise=(0.6, 1.1), limbs=(9, 12), droop=(1.2, 2.8), density=(0.45, 0.8), clump=(0.08, 0.14), shell=3.0,
    slenderness=0.3,
)  # fmt: skip
_SEVERAL_STEMS = replace(
    _ROUND, height=(4.0, 8.0), width=(0.65, 0.95), clear=(0.22, 0.32), profile=(0.7, 0.45), girth=(14, 20),
    limbs=(9, 13), stems=(2, 4), clump=(0.16, 0.3),
)  # fmt: skip
_YOUNG = replace(
    _ROUND, height=(2.6, 4.6), width=(0.25, 0.45), clear=(0.36, 0.5), profile=(0.45, 0.6), leader=(0.75, 0.95),
    rise=(0.5, 1.0), girth=(14, 24), limbs=(6, 9), density=(1.0, 2.2), clump=(0.1, 0.18),
)  # fmt: skip
_ROUND_SMALL = replace(_ROUND, height=(4.0, 7.0), clear=(0.26, 0.4), clump=(0.16, 0.28))
_BARE = replace(_ROUND, width=(0.5, 0.75), rise=(0.45, 1.05), density=(0.0, 0.0))

_GREENS = (("green", 5.0), ("dark", 2.0), ("light", 2.0), ("olive", 1.0), ("yellow", 0.4), ("copper", 0.4))
_BARKS = ("brown", "grey", "dark", "pale")

_PINE = Habit(
    height=(6.0, 13.5), width=(0.42, 0.7), clear=(0.38, 0.6), profile=(0.45, 0.4), leader=(0.6, 0.85),
    rise=(0.1, 0.7), girth=(14, 20), limbs=(9, 13), droop=(0.0, 0.1), density=(0.7, 1.2), clump=(0.22, 0.38),
    slenderness=0.3, shell=3.0,
)  # fmt: skip
_CEDAR = Habit(
    height=(7.0, 14.0), width=(0.55, 0.8), clear=(0.1, 0.2), profile=(0.3, 0.75), leader=(0.85, 0.93),
    rise=(-0.05, 0.3), girth=(14, 20), limbs=(14, 18), droop=(0.1, 0.5), density=(0.8, 1.3), clump=(0.2, 0.34),
    slenderness=0.35, shell=1.0,
)  # fmt: skip


def _colours(rng: np.random.Generator) -> Colours:
    weights = np.array([w for _, w in _GREENS])
    drawn = _GREENS[int(rng.choice(len(_GREENS), p=weights / weights.sum()))][0]
    trunk = bark(_BARKS[int(rng.choice(4, p=[0.45, 0.3, 0.15, 0.1]))], "trunk", rng)
    return Colours(trunk, same_as(trunk, "tree"), foliage(drawn, "tree", rng))


def _tree(rng: np.random.Generator, *, habit: Habit) -> Mesh:
    return grow_tree(rng, habit, _colours(rng))


def _staked(rng: np.random.Generator) -> Mesh:
    """Return a young tree tied to its stakes; the stakes are posts."""
    tree = grow_tree(rng, _YOUNG, _colours(rng), faces=2600)
    n = int(rng.integers(1, 4))
    azimuth = rng.uniform(0, 6.28) + np.arange(n) * 2 * np.pi / n
    out, height = rng.uniform(0.22, 0.45), rng.uniform(0.9, 1.9)
    feet = np.column_stack([out * np.cos(azimuth), out * np.sin(azimuth), np.full(n, -UNDERGROUND)])
    tops = feet * [0.9, 0.9, 0] + np.column_stack([rng.normal(0, 0.02, (n, 2)), height + rng.normal(0, 0.03, n)])
    wood = same_as(bark("stake", "tree", rng), "post")
    stakes = tubes(np.stack([feet, tops], 1), rng.uniform(0.025, 0.045), wood, sides=7, closed=True)
    tie = tops * [1, 1, 0] + [0, 0, 0.88 * height]
    straps = np.stack([tie, np.broadcast_to([0.0, 0.0, 0.88 * height], tie.shape)], 1)
    rubber = Surface(wood.label, (0.03, 0.03, 0.03), 0.1, DIFFUSE)
    return join([tree, stakes, tubes(straps, 0.015, rubber, sides=4)])


def _blooming(rng: np.random.Generator) -> Mesh:
    """Return a small tree in flower: most of its leaves are petals."""
    leafy = grow_tree(rng, _SEVERAL_STEMS if rng.random() < 0.5 else _ROUND_SMALL, _colours(rng), faces=3900)
    petals = foliage(("pink", "white", "purple", "red")[int(rng.integers(4))], "tree", rng)
    tips = leafy.vertices[leafy.faces[-1200:, 2]]
    at = tips[rng.integers(0, len(tips), int(rng.integers(900, 1900)))]
    at = at + rng.normal(0, 0.09, at.shape)
    size = rng.uniform(0.1, 0.18)
    return join([leafy, blades(at, rng.normal(size=at.shape), size, 0.9 * size, petals, rng)])


def _straight_stem(height: float, clear: float, radius: float, wood: Surface) -> Mesh:
    """Return a straight stem, `trunk` below the branches."""
    parts = []
    for heights, surface in ((np.array([-UNDERGROUND, 0.0, 0.2, clear]), wood),
                             (np.linspace(clear, height, 5), same_as(wood, "tree"))):  # fmt: skip
        path = np.column_stack([np.zeros((len(heights), 2)), heights])
        radii = radius * np.maximum(1 - heights / height, 0.02) * (1 + 0.35 * np.exp(-np.maximum(heights, 0) / 0.25))
        parts.append(tubes(path[None], radii[None], surface, sides=8))
    return join(parts)


def _whorls(rng: np.random.Generator, height: float, clear: float, reach: float) -> tuple[Floats, Floats]:
    """Return the branches of a spruce in whorls, each a curve of four points, and their lengths."""
    n_whorls, per = int(rng.integers(13, 18)), int(rng.integers(5, 7))
    t = np.repeat((np.arange(n_whorls) + rng.uniform(0.2, 0.8, n_whorls)) / n_whorls, per)
    t = np.clip(t + rng.normal(0, 0.012, len(t)), 0, 0.985)
    azimuth = np.arange(len(t)) * 2 * np.pi / per + np.repeat(rng.uniform(0, 6.28, n_whorls), per)
    azimuth += rng.normal(0, 0.18, len(t))
    lobe = 1 + 0.1 * np.cos(azimuth - rng.uniform(0, 6.28))
    length = (reach * (1 - t) ** rng.uniform(0.75, 1.0) + 0.12) * lobe * rng.uniform(0.82, 1.12, len(t))
    elevation = rng.uniform(-0.35, 0.05) + 0.85 * t + rng.normal(0, 0.06, len(t))
    s = np.linspace(0, 1, 4)[:, None]
    start = np.column_stack([np.zeros((len(t), 2)), clear + t * (height - clear)])
    sag = rng.uniform(0.1, 0.28) * length[:, None, None] * (1 - t)[:, None, None]
    along = length[:, None, None] * s * bearing(azimuth, elevation)[:, None]
    curve = start[:, None] + along - sag * (np.sin(np.pi * 0.8 * s)) * np.array([0, 0, 1.0])
    curve[:, :, 2] = np.maximum(curve[:, :, 2], 0.12)
    return curve, length


def _spruce(rng: np.random.Generator) -> Mesh:
    """Return a spruce: whorls of branches with hanging sprays of needles around a straight stem."""
    height = rng.uniform(4.5, 14.0)
    clear, reach = rng.uniform(0.2, 0.12 * height), 0.5 * height * rng.uniform(0.3, 0.45)
    wood = bark(("brown", "grey", "reddish")[int(rng.integers(3))], "trunk", rng)
    leaf = foliage("blue" if rng.random() < 0.25 else "needle", "tree", rng)
    paths, length = _whorls(rng, height, clear, reach)
    thick = (0.009 * length + 0.006)[:, None] * np.array([1.0, 0.8, 0.55, 0.2])
    stem = _straight_stem(height, clear, 0.5 * height * rng.uniform(0.016, 0.024), wood)
    meshes = [stem, tubes(paths, thick, same_as(wood, "tree"), sides=3)]
    n = 5800 - sum(len(m.faces) for m in meshes)
    which = rng.choice(len(paths), n, p=length / length.sum())
    s = 3 * rng.uniform(0.08, 1.0, n) ** 0.7
    low = np.minimum(s.astype(np.int64), 2)
    part = (s - low)[:, None]
    a, b = paths[which, low], paths[which, low + 1]
    forward = unit(b - a)
    side = unit(np.cross(forward, [0.0, 0.0, 1.0])) * rng.choice([-1.0, 1.0], (n, 1))
    direction = 0.8 * side * rng.uniform(0.2, 1.2, (n, 1)) + 0.7 * forward + rng.normal(0, 0.25, (n, 3))
    direction[:, 2] -= rng.uniform(0.1, 0.9)
    size = (0.14 + 0.12 * length[which]) * rng.uniform(0.6, 1.2, n)
    roots = a + part * (b - a)
    return join([*meshes, lift(blades(roots, direction, size, 0.42 * size, leaf, rng))])


def _column(
    rng: np.random.Generator, *, height: tuple[float, float], width: tuple[float, float], profile: tuple[float, float]
) -> Mesh:
    """Return a dense column or cone of upright sprays down to the ground."""
    tall = rng.uniform(*height)
    radius, foot = 0.5 * tall * rng.uniform(*width), rng.uniform(0.08, 0.04 * tall + 0.12)
    wood = bark("reddish", "trunk", rng)
    leaf = foliage(("needle", "dark", "blue", "green")[int(rng.choice(4, p=[0.5, 0.25, 0.1, 0.15]))], "tree", rng)
    outline = Outline(rng, foot, tall, radius, profile)
    stem = _straight_stem(0.9 * tall, max(foot, 0.25), 0.5 * tall * rng.uniform(0.02, 0.035), wood)
    n = 4600
    centres = outline.place(rng.random(n), rng.uniform(0, 6.28, n), rng.uniform(0.45, 1.0, n) ** 0.5)
    out = centres * [1, 1, 0] / radius
    direction = [0, 0, 1.0] + rng.uniform(0.2, 0.7) * out + rng.normal(0, 0.25, (n, 3))
    area = 2.2 * outline.volume ** (2 / 3) * 5.0 / n
    size = float(np.clip(np.sqrt(2 * area / 0.45), 0.07, 0.5)) * rng.uniform(0.7, 1.3, n)
    roots = centres - 0.5 * size[:, None] * unit(direction)
    return join([stem, lift(blades(roots, direction, size, 0.45 * size, leaf, rng))])


def _grown(rng: np.random.Generator, *, habit: Habit, wood: str) -> Mesh:
    """Return a pine or a cedar: a branching crown with tufts of needles."""
    trunk = bark(wood, "trunk", rng)
    leaf = foliage("blue" if rng.random() < 0.2 else "needle", "tree", rng)
    return grow_tree(rng, habit, Colours(trunk, same_as(trunk, "tree"), leaf))


DESIGNS: tuple[Design, ...] = (
    Design("round_tree", "tree", partial(_tree, habit=_ROUND), 0.9, 4.0),
    Design("mature_tree", "tree", partial(_tree, habit=_MATURE), 0.9, 3.0),
    Design("small_round_tree", "tree", partial(_tree, habit=_ROUND_SMALL), 0.7, 3.0),
    Design("columnar_tree", "tree", partial(_tree, habit=_COLUMNAR), 0.9, 1.5),
    Design("vase_tree", "tree", partial(_tree, habit=_VASE), 0.9, 2.0),
    Design("pyramidal_tree", "tree", partial(_tree, habit=_PYRAMID), 0.9, 2.0),
    Design("weeping_tree", "tree", partial(_tree, habit=_WEEPING), 0.9, 0.6),
    Design("multi_stem_tree", "tree", partial(_tree, habit=_SEVERAL_STEMS), 1.2, 1.2),
    Design("flowering_tree", "tree", _blooming, 1.0, 1.0),
    Design("young_staked_tree", "tree", _staked, 0.7, 1.2),
    Design("bare_tree", "tree", partial(_tree, habit=_BARE), 0.9, 0.8),
    Design("spruce", "tree", _spruce, 3.9, 1.0),
    Design("pine", "tree", partial(_grown, habit=_PINE, wood="reddish"), 0.9, 1.0),
    Design("cedar", "tree", partial(_grown, habit=_CEDAR, wood="grey"), 0.9, 0.6),
    Design("cypress", "tree", partial(_column, height=(4.0, 12.0), width=(0.12, 0.21), profile=(0.3, 0.55)), 1.2, 1.0),
    Design(
        "cone_conifer", "tree", partial(_column, height=(1.4, 4.0), width=(0.35, 0.55), profile=(0.2, 0.95)), 1.3, 0.7
    ),
)
