"""Broadleaf trees: round, mature, columnar, vase-shaped, weeping, of several stems, young with stakes, bare in winter.

Measures follow common tables of street trees: 6 to 15 m high, mature ones to 20, crowns of 3 to 12 m, stems of 0.1 to
0.6 m at breast height, the first limb above 1.8 m over pavements.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from mlsroad_pipeline.simulation.model.materials import bark, foliage, same_as
from mlsroad_pipeline.simulation.model.meshes import DIFFUSE, Design, Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import blades, tubes
from mlsroad_pipeline.simulation.plants.crowns import UNDERGROUND, Colours, Habit, grow_tree

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
_BARE = replace(_ROUND, width=(0.5, 0.75), rise=(0.45, 1.05), density=(0.0, 0.0))

_GREENS = (("green", 5.0), ("dark", 2.0), ("light", 2.0), ("olive", 1.0), ("yellow", 0.4), ("copper", 0.4))
_BARKS = ("brown", "grey", "dark", "pale")


def _colours(rng: np.random.Generator, leaf: str | None = None) -> Colours:
    weights = np.array([w for _, w in _GREENS])
    drawn = _GREENS[int(rng.choice(len(_GREENS), p=weights / weights.sum()))][0]
    trunk = bark(_BARKS[int(rng.choice(4, p=[0.45, 0.3, 0.15, 0.1]))], "trunk", rng)
    return Colours(trunk, same_as(trunk, "tree"), foliage(leaf or drawn, "tree", rng))


def _tree(rng: np.random.Generator, *, habit: Habit, leaf: str | None = None) -> Mesh:
    return grow_tree(rng, habit, _colours(rng, leaf))


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


_ROUND_SMALL = replace(_ROUND, height=(4.0, 7.0), clear=(0.26, 0.4), clump=(0.16, 0.28))

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
)
"""Every design of a broadleaf tree."""
