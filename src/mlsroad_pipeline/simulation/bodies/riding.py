"""Riders, fitted to the saddle, the pedals and the grips of their vehicle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mlsroad_pipeline.simulation.bodies.bodies import (
    FOREARM,
    HIP,
    SHANK,
    SHOULDER,
    SPINE,
    THIGH,
    UPPER_ARM,
    Build,
    Skeleton,
    bent_joint,
    clothe,
)
from mlsroad_pipeline.simulation.model.batches import Floats
from mlsroad_pipeline.simulation.model.meshes import Mesh

_Y = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]])


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
