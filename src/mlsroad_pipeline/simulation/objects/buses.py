"""Builders of buses for `vans_trucks`: front along +x, wheels on z = 0; every face is `bus`."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from mlsroad_pipeline.simulation.model.materials import car_paint, cloth, material
from mlsroad_pipeline.simulation.model.meshes import Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, quads, tube
from mlsroad_pipeline.simulation.objects.bodywork import (
    Body,
    lamps,
    mirrors,
    pillars,
    rails,
    seats,
    skin,
    steering_wheel,
    wheels,
)
from mlsroad_pipeline.simulation.objects.parts import loft, tinted

_LABEL = "bus"


def _coach(
    rng: np.random.Generator, span: tuple[float, float], measures: tuple[float, float, float, float],
    skins: tuple[Surface, Surface, Surface], *, head: bool, axles: list[float],
) -> tuple[Body, list[Mesh]]:  # fmt: skip
    """Return a body with a row of windows and seats; the head has a windscreen."""
    half, height, clear, belt = measures
    paint, glass, dark = skins
    rear, front = span
    slope = rng.uniform(0.08, 0.3) if head else 0.02
    top = [(rear, height - 0.1), (rear + 0.1, height), (front - slope - 0.02, height),
           (front - 0.02, belt + 0.04), (front, belt - 0.1)]  # fmt: skip
    if not head:
        top = [(rear, height - 0.05), (rear + 0.1, height), (front - 0.1, height), (front, height - 0.03)]
    line = [(rear, belt), (front - 0.05, belt), (front, belt - 0.12 if head else belt)]
    pitch = rng.uniform(1.35, 1.8)
    posts = np.linspace(rear + 0.25, front - slope - (0.3 if head else 0.15), max(int((front - rear) / pitch), 2) + 1)
    panes = [(a + 0.04, b - 0.04) for a, b in pairwise(posts)]
    edge = rng.uniform(0.93, 0.97)
    body = Body(half, clear, top, line, [(rear, edge), (front, edge)], axles, 0.48, rounding=0.3,
                drawn_in=0.07 if head else 0.01, side_panes=panes,
                top_panes=[(front - slope, front - 0.03)] if head else [])  # fmt: skip
    parts = [skin(body, paint, glass, dark), *pillars(body, posts[1:-1].tolist(), 0.03, dark)]
    if head:
        parts += rails(body, [(front - slope - 0.02, front - 0.02)], 0.045, paint)
    floor = clear + 0.08
    parts.append(box([front - rear - 0.5, 1.85 * half, 0.04], [(front + rear) / 2, 0, floor], dark))
    rows = np.arange(rear + 0.9, front - (2.2 if head else 0.5), rng.uniform(1.05, 1.4))
    cover, cushions = material("seat", _LABEL, rng), []
    for x in rows:
        for side in (-1, 1):
            y, z = side * 0.66 * half, floor + 0.48
            parts.append(box([0.1, 0.85, 0.7], [x - 0.2, y, z + 0.33], cover))
            cushions += [[x + dx, y + dy, z] for dx, dy in ((-0.2, -0.42), (0.25, -0.42), (0.25, 0.42), (-0.2, 0.42))]
    parts.append(quads(np.reshape(cushions, (-1, 4, 3)), cover))
    rail = material("galvanised", _LABEL, rng)
    parts += [tube([[x, 0.25, floor], [x, 0.25, height - 0.15]], 0.018, rail, sides=3) for x in rows[1::3]]
    return body, parts


def _skins(rng: np.random.Generator) -> tuple[Surface, Surface, Surface]:
    dark = tinted((0.03, 0.03, 0.03), _LABEL, 0.14, rng, spread=0.3)
    return car_paint(_LABEL, rng), material("glass", _LABEL, rng), dark


def _face(
    rng: np.random.Generator, body: Body, measures: tuple[float, float, float, float], dark: Surface
) -> list[Mesh]:
    """Return the front: mirrors on arms, sign, driver's seat, lamps."""
    half, height, clear, belt = measures
    front = body.top[-1][0]
    lit = tinted((0.5, 0.35, 0.05), _LABEL, 0.3, rng, spread=0.3)
    parts = [box([0.05, 1.5 * half, 0.24], [front - 0.12, 0, height - 0.16], lit)]
    parts += mirrors(rng, body, front + 0.05, height - rng.uniform(0.5, 1.0), 0.2, dark)
    parts += seats(_LABEL, rng, [front - 1.5], [0.6], clear + 0.55, 0.9)
    parts.append(steering_wheel(_LABEL, [front - 0.85, 0.6, belt + 0.05], rng))
    parts.append(box([0.35, 1.5 * half, 0.3], [front - 0.4, 0.1, belt - 0.2], dark))
    parts += lamps(rng, body, _LABEL, front=clear + 0.35, rear=None)
    if rng.random() < 0.5:  # air conditioning
        size = rng.uniform([1.5, 1.2, 0.15], [3.0, 1.9, 0.3])
        parts.append(box(size, [rng.uniform(-1.5, 1.0), 0, height + size[2] / 2], cloth(_LABEL, rng), taper=0.9))
    return parts


def _measures(rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Return half width, height, ground clearance and height of the belt line."""
    return rng.uniform(1.23, 1.275), rng.uniform(2.9, 3.25), rng.uniform(0.26, 0.36), rng.uniform(0.95, 1.3)


def bus(rng: np.random.Generator) -> Mesh:
    """Return a city or country bus of 8.5 to 12.8 m."""
    length, measures, skins = rng.uniform(8.5, 12.8), _measures(rng), _skins(rng)
    rear, front = -length / 2, length / 2
    axles = [rear + length * rng.uniform(0.2, 0.28), front - rng.uniform(2.4, 2.8)]
    body, parts = _coach(rng, (rear, front), measures, skins, head=True, axles=axles)
    parts += wheels(rng, body, _LABEL, width=0.3, steered=rng.normal(0, 0.06))
    parts += lamps(rng, body, _LABEL, front=None, rear=measures[2] + 0.75, upright=True)
    return join([*parts, *_face(rng, body, measures, skins[2])])


def articulated_bus(rng: np.random.Generator) -> Mesh:
    """Return a bus of two cars, somewhat bent at the bellows between them."""
    length, measures, skins = rng.uniform(17.2, 18.8), _measures(rng), _skins(rng)
    rear, front = -length / 2, length / 2
    joint = front - rng.uniform(9.6, 10.4)
    head, parts = _coach(
        rng, (joint + 0.6, front), measures, skins, head=True, axles=[joint + 1.9, front - rng.uniform(2.4, 2.8)]
    )
    tail, behind = _coach(rng, (rear, joint - 0.6), measures, skins, head=False, axles=[rear + rng.uniform(2.9, 3.4)])
    width = 0.3
    parts += wheels(rng, head, _LABEL, width=width, steered=rng.normal(0, 0.06))
    behind += wheels(rng, tail, _LABEL, width=width)
    behind += lamps(rng, tail, _LABEL, front=None, rear=measures[2] + 0.75, upright=True)
    half, height, clear, _ = measures
    bend = rng.normal(0, 0.05)
    rubber, folds = material("rubber", _LABEL, rng), 13
    section = np.array([[half, clear + 0.1], [half, height - 0.1], [0.85 * half, height], [-0.85 * half, height],
                        [-half, height - 0.1], [-half, clear + 0.1]])  # fmt: skip
    rings = []
    for k, f in enumerate(np.linspace(1, -1, folds)):
        ring = np.column_stack([np.zeros(6), section * [0.97 - 0.05 * (k % 2), 1.0]])
        yaw = bend * (1 - f) / 2
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        rings.append((ring + np.array([0.62 * f, 0, 0])) @ turn.T + np.array([joint, 0, 0]))
    parts.append(loft(np.array(rings), rubber, closed=False))
    bent = join(behind).moved([-joint, 0, 0]).moved([joint, 0, 0], yaw=bend)
    face = _face(rng, head, measures, skins[2])
    return join([*parts, bent, *face])
