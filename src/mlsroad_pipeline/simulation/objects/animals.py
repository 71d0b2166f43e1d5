"""Dogs and cats: standing, walking, sitting and lying.

Measures follow breed standards: dogs of 0.2 to 0.75 m at the withers and 1.0 to 1.2 times as long, cats of 0.23 to
0.28 m.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.bodies import bent_joint, capsules
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import Floats, blades, unit

_FURS = ((0.03, 0.027, 0.025), (0.16, 0.095, 0.05), (0.36, 0.25, 0.14), (0.62, 0.58, 0.52), (0.2, 0.19, 0.18),
         (0.30, 0.13, 0.05))  # fmt: skip


class _Shape(NamedTuple):
    """Ranges of a kind of animal: height at the withers in metres, the others over it."""

    withers: tuple[float, float]
    length: tuple[float, float]
    girth: tuple[float, float]
    muzzle: tuple[float, float]
    tail: tuple[float, float]


_DOG = _Shape((0.2, 0.72), (1.0, 1.25), (0.14, 0.2), (0.1, 0.26), (0.3, 0.6))
_CAT = _Shape((0.23, 0.28), (1.15, 1.35), (0.17, 0.23), (0.04, 0.08), (0.85, 1.1))


class _Frame(NamedTuple):
    """Joints of an animal: rump and chest, hips and shoulders, paws, and the direction of the head."""

    rump: Floats
    chest: Floats
    upper: Floats
    paws: Floats
    nose: Floats


def _fur(rng: np.random.Generator) -> Surface:
    base = np.array(_FURS[int(rng.integers(len(_FURS)))]) * np.exp(rng.normal(0, 0.25)) * np.exp(rng.normal(0, 0.08, 3))
    r, g, b = (float(c) for c in base.clip(0.01, 0.9))
    return Surface(TAXONOMY["animal"], (r, g, b), float(np.clip(0.15 + 0.8 * r**0.7 + rng.normal(0, 0.05), 0.08, 0.8)))


def _frame(rng: np.random.Generator, pose: str, s: float, length: float, girth: float) -> _Frame:
    """Return the joints of a pose: `stand`, `walk`, `sit` or `lie`."""
    half, wide = 0.5 * length * s, 0.11 * s
    y = np.array([[0, -wide, 0], [0, wide, 0]])
    tall = s * (1 - girth)
    rump, chest = np.array([-half + 0.1 * s, 0, 0.98 * tall]), np.array([half - 0.1 * s, 0, tall])
    fore, hind = np.array([half - 0.12 * s, 0, 0.0]) + y, np.array([-half + 0.02 * s, 0, 0.0]) + y
    nose = unit([1.0, rng.normal(0, 0.35), rng.uniform(-0.35, 0.45)])
    if pose == "walk":
        step = rng.uniform(0.12, 0.26) * s * np.array([1.0, -1.0]) * float(rng.choice([-1.0, 1.0]))
        fore[:, 0] += step
        hind[:, 0] -= step
        fore[0 if step[0] > 0 else 1, 2] += rng.uniform(0, 0.08) * s
    elif pose == "sit":
        rump = np.array([-0.32 * s, 0, (girth + 0.05) * s])
        chest = np.array([0.1 * s, 0, 0.74 * s])
        fore, hind = np.array([0.18 * s, 0, 0]) + y, np.array([0.02 * s, 0, 0]) + 1.5 * y
    elif pose == "lie":
        rump, chest = np.array([-half, 0, girth * s]), np.array([half - 0.15 * s, 0, 1.25 * girth * s])
        fore, hind = np.array([half + 0.3 * s, 0, 0.0]) + y, np.array([-half + 0.4 * s, 0, 0.0]) + 1.7 * y
    upper = np.concatenate([chest + y - [0.02 * s, 0, 0.08 * s], rump + y])
    paws = np.concatenate([fore, hind]) + np.array([0, 0, 0.045 * s])
    return _Frame(rump, chest, upper, paws, nose)


def _animal(rng: np.random.Generator, *, shape: _Shape, pose: str) -> Mesh:
    """Return a four-legged animal that faces +x."""
    low, high = shape.withers
    s = float(low * (high / low) ** rng.random())
    length, girth = rng.uniform(*shape.length), rng.uniform(*shape.girth)
    f = _frame(rng, pose, s, length, girth)
    coat, marks = _fur(rng), _fur(rng)
    bend = np.array([[-1.0, 0, 0.1], [-1.0, 0, 0.1], [1.0, 0, 0.2], [1.0, 0, 0.2]])
    leg = 0.36 * s
    joints = np.concatenate([bent_joint(f.upper[k : k + 1], f.paws[k : k + 1], leg, leg, bend[k]) for k in range(4)])
    joints[:, 2] = np.maximum(joints[:, 2], 0.07 * s)
    thick = np.array([0.075, 0.075, 0.1, 0.1]) * s
    paw_coat = marks if rng.random() < 0.3 else coat
    meshes = [capsules(f.upper, joints, thick, 0.05 * s, coat, sides=5),
              capsules(joints, f.paws, 0.048 * s, 0.036 * s, paw_coat, sides=5)]  # fmt: skip
    head = f.chest + s * np.array([0.24, 0.1 * f.nose[1], 0.3 if pose != "lie" else 0.22])
    tip = head + (0.08 + rng.uniform(*shape.muzzle)) * s * f.nose
    lift = float(rng.uniform(-0.9, 0.9))
    tail = unit([-1.0, rng.normal(0, 0.3), lift]) * rng.uniform(*shape.tail) * s
    end = f.rump + tail * (0.5 if pose == "sit" else 1.0)
    end[2] = max(end[2], 0.05 * s)
    g = girth * s
    body = [(f.rump, f.chest, 0.85 * g, 1.1 * g, coat), (f.chest, head, 0.7 * g, 0.55 * g, coat),
            (head - 0.03 * s * f.nose, head + 0.06 * s * f.nose, 0.11 * s, 0.1 * s, coat),
            (head + 0.04 * s * f.nose, tip, 0.075 * s, 0.05 * s, marks),
            (f.rump + np.array([-0.05 * s, 0, 0.3 * g]), end, 0.035 * s, 0.022 * s, coat)]  # fmt: skip
    meshes.append(capsules([b[0] for b in body], [b[1] for b in body], [b[2] for b in body], [b[3] for b in body],
                           [b[4] for b in body], sides=7))  # fmt: skip
    roots = head + s * np.array([[-0.03, -0.07, 0.07], [-0.03, 0.07, 0.07]])
    hanging = shape is _DOG and rng.random() < 0.5
    point = np.array([[0, -0.9, -1.0], [0, 0.9, -1.0]]) if hanging else np.array([[0, -0.3, 1.0], [0, 0.3, 1.0]])
    meshes.append(blades(roots, point, 0.13 * s, 0.08 * s, coat, rng, across=np.tile([1.0, 0.3, 0], (2, 1))))
    mesh = join(meshes)
    return mesh.moved([0, 0, -float(mesh.vertices[:, 2].min())])


DESIGNS: tuple[Design, ...] = (
    Design("standing_dog", "animal", partial(_animal, shape=_DOG, pose="stand"), 1.1, 1.0),
    Design("walking_dog", "animal", partial(_animal, shape=_DOG, pose="walk"), 1.1, 1.5),
    Design("sitting_dog", "animal", partial(_animal, shape=_DOG, pose="sit"), 0.7, 0.7),
    Design("lying_dog", "animal", partial(_animal, shape=_DOG, pose="lie"), 1.1, 0.4),
    Design("standing_cat", "animal", partial(_animal, shape=_CAT, pose="stand"), 0.6, 0.4),
    Design("sitting_cat", "animal", partial(_animal, shape=_CAT, pose="sit"), 0.5, 0.4),
)
