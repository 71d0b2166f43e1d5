"""Bodies of people and riders, composed of capsules between joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.materials import cloth, material
from mlsroad_pipeline.simulation.model.meshes import Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import Floats, tubes, unit

# Lengths of the segments of a body over its height (Drillis and Contini 1966).
THIGH, SHANK, UPPER_ARM, FOREARM, SPINE = 0.245, 0.246, 0.186, 0.17, 0.288
ANKLE, FOOT, SHOULDER, HIP = 0.039, 0.152, 0.115, 0.052
"""Segments of a body over its height; shoulder and hip are half of the widths between the joints."""

_Y = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]])


class Skeleton(NamedTuple):
    """Joints of a body that faces +x; the right one of a pair comes first."""

    # hips, knees, ankles, shoulders, elbows, wrists: joints, metres
    hips: Floats
    knees: Floats
    ankles: Floats
    shoulders: Floats
    elbows: Floats
    wrists: Floats
    feet: Floats  # Unit vectors from heel to toe
    head: Floats  # Its middle, metres

    def moved(self, shift: ArrayLike) -> Skeleton:
        """Return the skeleton shifted, in the same pose."""
        by = np.asarray(shift, dtype=np.float64)
        return Skeleton(*(part if k == 6 else part + by for k, part in enumerate(self)))


def capsules(
    starts: ArrayLike, ends: ArrayLike, first: ArrayLike, last: ArrayLike, surfaces: Surface | Sequence[Surface],
    *, sides: int = 6,
) -> Mesh:  # fmt: skip
    """Return limbs between joints of shape (n, 3): bars with rounded ends, thickest at a third of their length.

    `first` and `last` are the radii at either joint, metres. Each limb has ``10 sides - 4`` faces.
    """
    a, b = np.asarray(starts, dtype=np.float64), np.asarray(ends, dtype=np.float64)
    n = len(a)
    r0 = np.broadcast_to(np.asarray(first, dtype=np.float64), (n,))[:, None]
    r1 = np.broadcast_to(np.asarray(last, dtype=np.float64), (n,))[:, None]
    along = unit(b - a)[:, None]
    length = np.sqrt(((b - a) ** 2).sum(axis=1))[:, None]
    middle = 0.35 * length
    at = np.concatenate([-0.85 * r0, -0.3 * r0, middle, length + 0.3 * r1, length + 0.85 * r1], axis=1)
    radii = np.concatenate([0.5 * r0, 0.95 * r0, 0.7 * r0 + 0.36 * r1, 0.95 * r1, 0.5 * r1], axis=1)
    return tubes(a[:, None] + at[:, :, None] * along, radii, surfaces, sides=sides, closed=True)


def bent_joint(start: ArrayLike, end: ArrayLike, upper: float, lower: float, towards: ArrayLike) -> Floats:
    """Return the middle joints, (n, 3), of two-part limbs between ends of shape (n, 3), bent in a direction `towards`.

    `upper` and `lower` are the lengths of the parts, metres; limbs that are too short are stretched.
    """
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    span = np.sqrt(((b - a) ** 2).sum(axis=1, keepdims=True))
    axis = (b - a) / (span + 1e-12)
    along = np.clip((upper**2 - lower**2 + span**2) / (2 * span + 1e-12), 0.0, span)
    aside = np.sqrt(np.maximum(upper**2 - along**2, 1e-6))
    out = np.broadcast_to(np.asarray(towards, dtype=np.float64), a.shape)
    return a + along * axis + aside * unit(out - (out * axis).sum(axis=1, keepdims=True) * axis)


class Build(NamedTuple):
    """Appearance of one person."""

    height: float  # Metres
    girth: float  # Thickness of limbs and trunk over that of an average adult of this height
    head: float  # Half of the head's height, metres
    clothes: str  # Clothes below the waist
    hair: str  # Hair or headgear


def draw_build(rng: np.random.Generator, *, child: bool = False) -> Build:
    """Draw a person: adults of 1.50 to 1.95 m, children of 0.95 to 1.45 m."""
    height = float(rng.uniform(0.95, 1.45) if child else np.clip(rng.normal(1.71, 0.09), 1.5, 1.95))
    head = float((0.085 + 0.028 * height if child else 0.068 * height + 0.005) * rng.uniform(0.96, 1.06))
    clothes = ("trousers", "shorts", "skirt", "dress", "coat")[int(rng.choice(5, p=[0.55, 0.13, 0.1, 0.1, 0.12]))]
    hair = ("short", "long", "hat")[int(rng.choice(3, p=[0.5, 0.32, 0.18]))]
    return Build(height, float(rng.uniform(0.88, 1.3)), head, clothes, hair)


def clothe(rng: np.random.Generator, bones: Skeleton, build: Build, label: str) -> Mesh:
    """Return a clothed body of some 700 faces; `label` is the class of every face."""
    h, g = build.height / 1.7, build.girth
    skin, shirt, lower = material("skin", label, rng), cloth(label, rng), cloth(label, rng)
    shank = skin if build.clothes in ("shorts", "skirt", "dress") else lower
    thigh = {"dress": shirt, "coat": lower, "skirt": skin}.get(build.clothes, lower)
    forearm = skin if rng.random() < 0.45 else shirt
    legs = [(bones.hips, bones.knees, 0.083, 0.058, thigh), (bones.knees, bones.ankles, 0.056, 0.038, shank)]
    arms = [(bones.shoulders, bones.elbows, 0.05, 0.04, shirt), (bones.elbows, bones.wrists, 0.038, 0.026, forearm)]
    meshes = [capsules(
        np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts]),
        np.repeat([p[2] for p in parts], 2) * h * g, np.repeat([p[3] for p in parts], 2) * h * g,
        [p[4] for p in parts for _ in range(2)], sides=sides,
    ) for parts, sides in ((legs, 6), (arms, 5))]  # fmt: skip
    shoes = Surface(TAXONOMY[label], *_dark(rng))
    meshes.append(capsules(bones.ankles - 0.03 * h * bones.feet - [0, 0, 0.012 * h],
                           bones.ankles + 0.13 * h * bones.feet - [0, 0, 0.018 * h], 0.034 * h, 0.03 * h, shoes,
                           sides=4))  # fmt: skip
    meshes += _trunk(bones, build, shirt, {"coat": shirt, "dress": shirt}.get(build.clothes, lower))
    if build.clothes in ("skirt", "dress", "coat"):
        meshes.append(_skirt(bones, build, lower if build.clothes == "skirt" else shirt))
    return join([*meshes, *_head(rng, bones, build, skin, label)])


def _dark(rng: np.random.Generator) -> tuple[tuple[float, float, float], float]:
    tone = float(rng.uniform(0.02, 0.2))
    return (tone, 0.9 * tone, 0.8 * tone), float(rng.uniform(0.08, 0.4))


def _trunk(bones: Skeleton, build: Build, shirt: Surface, lower: Surface) -> list[Mesh]:
    """Return hips, belly and chest, wider than deep, and the neck."""
    h, g = build.height / 1.7, build.girth
    foot, top = bones.hips.mean(axis=0), bones.shoulders.mean(axis=0)
    along = top - foot
    s = np.array([-0.22, -0.02, 0.25, 0.55, 0.85, 1.02, 1.12])
    bow = np.column_stack([0.03 * h * np.sin(np.pi * s), 0 * s, 0 * s])
    path = foot + s[:, None] * along + bow
    depth = np.array([0.075, 0.105, 0.1, 0.115, 0.115, 0.085, 0.05]) * h * np.array([g, g, g**1.4, g, g, 1, 1])
    width = np.array([1.3, 1.55, 1.4, 1.4, 1.55, 1.6, 1.1]) / g**0.25
    pelvis = tubes(path[None, :3], depth[None, :3], lower, sides=8, closed=True, flatten=width[None, :3])
    chest = tubes(path[None, 2:], depth[None, 2:] * 1.01, shirt, sides=8, closed=True, flatten=width[None, 2:])
    neck = tubes(np.stack([top, bones.head])[None], 0.052 * h, shirt, sides=6)
    return [pelvis, chest, neck]


def _skirt(bones: Skeleton, build: Build, surface: Surface) -> Mesh:
    """Return cloth from the waist to the knees over both legs."""
    h, g = build.height / 1.7, build.girth
    waist = bones.hips.mean(axis=0) + 0.25 * (bones.shoulders.mean(axis=0) - bones.hips.mean(axis=0))
    hem = bones.knees.mean(axis=0)
    stride = float(np.abs(bones.knees[0, 0] - bones.knees[1, 0]))
    s = np.array([0.0, 0.45, 1.0])[:, None]
    path = (1 - s) * waist + s * hem
    radii = np.array([0.11 * g, 0.145 * g, 0.15 * g]) * h + np.array([0.0, 0.15, 0.34]) * stride
    return tubes(path[None], radii[None], surface, sides=8, flatten=np.array([[1.4, 1.3, 1.15]]))


def _head(rng: np.random.Generator, bones: Skeleton, build: Build, skin: Surface, label: str) -> list[Mesh]:
    """Return the head with hair or headgear."""
    latitude = np.linspace(-1.3, 1.3, 5)
    size = build.head
    up = unit(bones.head - bones.shoulders.mean(axis=0)) * 0.5 + [0, 0, 0.5]
    path = bones.head + np.outer(np.sin(latitude), up * size)
    radii = 0.8 * size * np.cos(latitude) * np.array([0.9, 0.95, 1, 1, 1])
    meshes = [tubes(path[None], radii[None], skin, sides=8, closed=True, flatten=0.86)]
    if build.hair == "helmet":
        cover = cloth(label, rng)
    else:
        cover = Surface(TAXONOMY[label], *_dark(rng)) if build.hair != "hat" else cloth(label, rng)
    grown = 1.16 if build.hair in ("helmet", "hat") else 1.07
    low = {"long": -1.9, "short": -0.1, "hat": 0.35, "helmet": -0.25}[build.hair]
    s = np.array([low, 0.3 if low < 0.3 else 0.55, 0.75, 1.02])
    cap = bones.head + np.outer(s, up * size) + [-0.12 * size, 0, 0]
    shape = 0.8 * size * grown * np.array([0.75 if low < -1 else 0.95, 0.98, 0.75, 0.3])
    if build.hair == "hat":
        shape[0] *= rng.uniform(1.0, 1.9)
    meshes.append(tubes(cap[None], shape[None], cover, sides=8, closed=True, flatten=0.9))
    return meshes


class Contacts(NamedTuple):
    """Contact points of a rider on a vehicle; the right one of a pair comes first."""

    saddle: Floats  # Top of the saddle, metres
    pedals: Floats  # Places of the balls of the feet, metres
    grips: Floats  # Places of the hands, metres


def seat_rider(rng: np.random.Generator, build: Build, contacts: Contacts, label: str = "rider") -> Mesh:
    """Return a rider facing +x with hands, feet and seat on the contact points; long clothes are worn as trousers."""
    worn = build.clothes if build.clothes == "shorts" else "trousers"
    build = build._replace(clothes=worn)
    h = build.height
    hips = contacts.saddle + HIP * h * _Y + [0.0, 0.0, 0.045 * h * build.girth]
    ankles = contacts.pedals + np.array([-0.05 * h, 0.0, 0.055 * h])
    knees = bent_joint(hips, ankles, THIGH * h, SHANK * h, [1.0, 0.0, 0.5])
    # The trunk leans until the arms are almost straight.
    lean = np.linspace(0.0, 1.1, 45)
    chest = hips.mean(axis=0) + SPINE * h * np.stack([np.sin(lean), 0 * lean, np.cos(lean)], 1)
    reach = np.sqrt(((contacts.grips.mean(axis=0) - chest)[:, [0, 2]] ** 2).sum(axis=1))
    k = int(np.abs(reach - 0.88 * (UPPER_ARM + FOREARM) * h).argmin())
    shoulders = chest[k] + SHOULDER * h * build.girth**0.3 * _Y
    wrists = contacts.grips + np.array([-0.03, 0.0, 0.01])
    elbows = bent_joint(shoulders, wrists, UPPER_ARM * h, FOREARM * h, [-0.3, 0.0, -1.0]) + 0.03 * _Y
    bow = 0.6 * lean[k]
    head = chest[k] + (0.04 * h + 1.05 * build.head) * np.array([np.sin(bow), 0.0, np.cos(bow)])
    feet = np.tile([0.97, 0.0, -0.2], (2, 1))
    return clothe(rng, Skeleton(hips, knees, ankles, shoulders, elbows, wrists, feet, head), build, label)


def helmeted(build: Build, rng: np.random.Generator, *, share: float) -> Build:
    """Return the person with a helmet, at the probability `share`, else without a hat."""
    hair = "helmet" if rng.random() < share else "short" if build.hair == "hat" else build.hair
    return build._replace(hair=hair)
