"""Builders of lorries for `vans_trucks`: front along +x, wheels on z = 0; every face is `truck`."""

from collections.abc import Sequence

import numpy as np

from mlsroad_pipeline.simulation.model.materials import SIGN, car_paint, cloth, material, retroreflective
from mlsroad_pipeline.simulation.model.meshes import Mesh, join
from mlsroad_pipeline.simulation.model.solids import box, tube
from mlsroad_pipeline.simulation.objects.bodywork import (
    Body,
    lamps,
    mirrors,
    rails,
    seats,
    skin,
    steering_wheel,
    wheel,
)
from mlsroad_pipeline.simulation.objects.parts import loft, rounded, tinted

_LABEL = "truck"


def _cab(
    rng: np.random.Generator, front: float, half: float, height: float, *, bonnet: float
) -> tuple[list[Mesh], float]:
    """Return a driver's cab without wheels with its nose at `front`, and the x of its rear wall."""
    deep = rng.uniform(1.5, 2.1) + bonnet
    rear, clear = front - deep, rng.uniform(0.38, 0.5)
    belt = min(rng.uniform(1.35, 1.6), 0.68 * height)
    cowl = front - max(bonnet, rng.uniform(0.05, 0.15))
    screen_top = cowl - rng.uniform(0.15, 0.4)
    nose = belt * (0.82 if bonnet > 0.3 else 0.95)
    top = [(rear, height - 0.05), (screen_top, height), (cowl, belt + 0.05), (front - 0.03, nose + 0.03), (front, nose)]
    line = [(rear, belt), (cowl, belt), (front - 0.03, nose), (front, nose - 0.03)]
    body = Body(half, clear, top, line, [(rear, 0.93), (screen_top, 0.92), (cowl, 0.9), (front, 0.88)], (), 0.4,
                rounding=0.3, drawn_in=0.08, side_panes=[(max(rear + 0.5, cowl - 1.15), cowl - 0.18)],
                top_panes=[(screen_top + 0.02, cowl - 0.01)])  # fmt: skip
    paint, glass = car_paint(_LABEL, rng), material("glass", _LABEL, rng)
    dark = tinted((0.03, 0.03, 0.03), _LABEL, 0.14, rng)
    parts = [skin(body, paint, glass, dark), *rails(body, [(screen_top, cowl)], 0.045, paint)]
    parts += mirrors(rng, body, cowl - 0.1, belt + 0.35, 0.24, dark)
    parts += lamps(rng, body, _LABEL, front=clear + 0.3, rear=None)
    parts.append(box([0.4, 1.7 * half, 0.25], [cowl - 0.35, 0, belt - 0.15], dark))
    parts.append(steering_wheel(_LABEL, [cowl - 0.7, 0.5, belt + 0.05], rng))
    parts += seats(_LABEL, rng, [cowl - 1.2], [-0.55, 0.55], clear + 0.75, 0.9)
    bumper = box([0.15, 1.96 * half, 0.3], [front - 0.02, 0, clear + 0.1], dark)
    return [*parts, bumper], rear


def _running_gear(
    rng: np.random.Generator, axles: Sequence[float], steered: float, half: float, radius: float
) -> list[Mesh]:
    """Return frame rails and wheels; all but the steered axle have twin tyres."""
    tyre, rim = material("rubber", _LABEL, rng), material("aluminium", _LABEL, rng)
    dark = tinted((0.04, 0.04, 0.04), _LABEL, 0.15, rng)
    parts, turn = [], rng.normal(0, 0.06)
    single, twin = wheel(rng, radius, 0.3, tyre, rim), wheel(rng, radius, 0.56, tyre, rim)
    for x in axles:
        one, wide = (single, 0.3) if x == steered else (twin, 0.56)
        for side, yaw in ((1, 0.0), (-1, np.pi)):
            at = [x, side * (half - wide / 2 - 0.03), radius]
            parts.append(one.moved(at, yaw=yaw + (turn if x == steered else 0.0)))
        parts.append(box([0.14, 1.2 * half, 0.14], [x, 0, radius], dark))
    return parts


def _frame(rng: np.random.Generator, span: tuple[float, float], z: float, half: float) -> list[Mesh]:
    """Return a ladder frame, a tank and the guards at its sides and its rear."""
    dark = tinted((0.05, 0.05, 0.05), _LABEL, 0.18, rng, spread=0.3)
    length, middle = span[1] - span[0], (span[0] + span[1]) / 2
    parts = [box([length, 0.08, 0.25], [middle, y, z - 0.13], dark) for y in (-0.4, 0.4)]
    tank = material("aluminium", _LABEL, rng)
    at = span[1] - rng.uniform(0.9, 1.3)
    side = float(rng.choice([-1, 1])) * (half - 0.35)
    parts.append(tube([[at - 0.45, side, z - 0.45], [at + 0.45, side, z - 0.45]], 0.28, tank, sides=10))
    red, white = retroreflective(SIGN.red, _LABEL, rng), retroreflective(SIGN.white, _LABEL, rng)
    parts.append(box([0.08, 1.9 * half, 0.12], [span[0] + 0.05, 0, 0.55], dark))
    for y in (-0.8 * half, 0.8 * half):
        parts.append(box([0.05, 0.35, 0.14], [span[0] - 0.01, y, 0.75 if z > 0.9 else 0.62], red))
        parts.append(box([0.06, 0.06, max(z - 0.55, 0.1)], [span[0] + 0.05, 0.6 * y, (z + 0.55) / 2], dark))
    parts.append(box([0.012, 0.52, 0.11], [span[0] - 0.005, 0, 0.57], white))
    return parts


def _contour(rng: np.random.Generator, span: tuple[float, float], half: float, z: float) -> list[Mesh]:
    """Return the prescribed reflecting tape along the lower edges of a lorry's sides."""
    tape = retroreflective(SIGN.white if rng.random() < 0.5 else SIGN.yellow, _LABEL, rng)
    length, middle = span[1] - span[0], (span[0] + span[1]) / 2
    return [box([0.96 * length, 0.006, 0.06], [middle, y, z], tape) for y in (-half - 0.003, half + 0.003)]


def _chassis(rng: np.random.Generator) -> tuple[list[Mesh], tuple[float, float], float, float, float]:
    """Return cab, frame and wheels of a lorry, the span and the half width of its body, its floor and its size."""
    size = rng.random()
    length, half = 5.8 + 3.4 * size, 1.05 + 0.2 * size
    rear, front = -length / 2, length / 2
    radius, floor = 0.38 + 0.13 * size, 0.85 + 0.25 * size + rng.uniform(0, 0.1)
    height = 2.15 + 0.85 * size + rng.uniform(0, 0.25)
    bonnet = rng.uniform(0.5, 0.9) if rng.random() < 0.25 else 0.0
    parts, wall = _cab(rng, front, half * rng.uniform(0.93, 1.0), height, bonnet=bonnet)
    steer = front - 0.75 - radius - 0.3 * bonnet if bonnet == 0 else front - 0.6 - radius
    axles = [rear + rng.uniform(1.2, 1.9), steer]
    if size > 0.75 and rng.random() < 0.6:
        axles.insert(0, axles[0] + 1.3)
    parts += _running_gear(rng, axles, steer, half, radius)
    span = (rear, wall - rng.uniform(0.05, 0.2))
    parts += _frame(rng, (rear + 0.05, wall + 0.2), floor, half)
    return parts, span, half, floor, size


def box_truck(rng: np.random.Generator) -> Mesh:
    """Return a lorry with a closed box or a curtain over bows, some with a spoiler above the cab."""
    parts, span, half, floor, size = _chassis(rng)
    tall, length, middle = 1.9 + 0.7 * size + rng.uniform(-0.1, 0.2), span[1] - span[0], (span[0] + span[1]) / 2
    skin_of_box = tinted((0.7, 0.7, 0.69), _LABEL, 0.5, rng) if rng.random() < 0.6 else cloth(_LABEL, rng)
    parts.append(box([length, 2 * half, tall], [middle, 0, floor + tall / 2], skin_of_box))
    metal = material("aluminium", _LABEL, rng)
    edge = 0.05
    for y in (-half, half):
        parts += [box([length + edge, edge, 2 * edge], [middle, y, z], metal) for z in (floor, floor + tall)]
    parts += [box([edge, edge, tall], [x, y, floor + tall / 2], metal) for x in span for y in (-half, half)]
    return join([*parts, *_contour(rng, span, half + 0.025, floor + 0.02)])


def flatbed_truck(rng: np.random.Generator) -> Mesh:
    """Return a lorry with an open platform between drop sides, empty or with crates."""
    parts, span, half, floor, _ = _chassis(rng)
    length, middle = span[1] - span[0], (span[0] + span[1]) / 2
    wood, metal = material("wood", _LABEL, rng), material("aluminium", _LABEL, rng)
    tall = rng.uniform(0.3, 0.65)
    parts.append(box([length, 2 * half, 0.1], [middle, 0, floor + 0.05], wood))
    parts += [box([length, 0.03, tall], [middle, y, floor + 0.1 + tall / 2], metal) for y in (-half, half)]
    parts.append(box([0.03, 2 * half, tall], [span[0], 0, floor + 0.1 + tall / 2], metal))
    parts.append(box([0.05, 2 * half, rng.uniform(0.8, 1.4)], [span[1], 0, floor + 0.6], metal))
    for _ in range(int(rng.integers(0, 7))):
        size = rng.uniform(0.4, 1.2, 3)
        x = rng.uniform(span[0] + 0.7, max(span[1] - 0.7, span[0] + 0.8))
        y = rng.uniform(-1, 1) * max(half - 0.7 * size[1], 0.05)
        crate = material(str(rng.choice(["wood", "plastic", "concrete"])), _LABEL, rng)
        parts.append(box(size, [x, y, floor + 0.1 + size[2] / 2], crate))
    return join([*parts, *_contour(rng, span, half, floor + 0.05)])


def tipper_truck(rng: np.random.Generator) -> Mesh:
    """Return a lorry with a skip whose walls slope, empty or heaped."""
    parts, span, half, floor, size = _chassis(rng)
    steel = tinted((0.25, 0.2, 0.12), _LABEL, 0.3, rng, spread=0.5)
    tall = 0.8 + 0.6 * size + rng.uniform(0, 0.3)
    length, middle = span[1] - span[0], (span[0] + span[1]) / 2

    def ring(z: float, shrink: float) -> np.ndarray:
        outline = rounded(length * shrink, 2 * half * shrink, 0.06)
        return np.column_stack([outline + np.array([middle, 0]), np.full(12, z)])

    levels = [ring(floor, 0.86), ring(floor + tall, 1.0), ring(floor + tall, 0.96), ring(floor + 0.08, 0.82)]
    parts += [loft(levels, steel, closed=False), loft([ring(floor, 0.84), ring(floor + 0.08, 0.84)], steel)]
    for x in np.linspace(span[0] + 0.3, span[1] - 0.3, 6):
        for side in (-1, 1):
            rib = [[x, side * 0.88 * half, floor], [x, side * 1.01 * half, floor + tall]]
            parts.append(tube(rib, 0.05, steel, sides=4))
    if rng.random() < 0.5:
        earth = tinted((0.2, 0.15, 0.1), _LABEL, 0.3, rng, spread=0.4)
        heap = rng.uniform(0.5, 1.1)
        parts.append(loft([ring(floor + 0.5 * tall, 0.88), ring(floor + heap * tall + 0.1, 0.45)], earth))
    return join([*parts, *_contour(rng, span, half * 0.9, floor - 0.03)])


def _trailer(rng: np.random.Generator, span: tuple[float, float], half: float, floor: float) -> list[Mesh]:
    """Return the load of a semi-trailer: a curtain-sided box, a tank, or a container."""
    length, middle = span[1] - span[0], (span[0] + span[1]) / 2
    kind = int(rng.choice(3, p=[0.55, 0.2, 0.25]))
    if kind == 0:
        tall = rng.uniform(2.5, 2.8)
        body = cloth(_LABEL, rng) if rng.random() < 0.6 else tinted((0.7, 0.7, 0.69), _LABEL, 0.5, rng)
        return [box([length, 2 * half, tall], [middle, 0, floor + tall / 2], body),
                *_contour(rng, span, half, floor + 0.05)]  # fmt: skip
    if kind == 1:
        shine, radius = material("aluminium", _LABEL, rng), rng.uniform(0.95, 1.15)
        turn = np.arange(14) * 2 * np.pi / 14
        ring = np.column_stack([np.zeros(14), half * np.cos(turn), radius * np.sin(turn)])
        xs, scale = np.array([0.0, 0.04, 0.96, 1.0]) * length + span[0], (0.75, 1.0, 1.0, 0.75)
        rings = [ring * [1, s, s] + [x, 0, floor + radius] for x, s in zip(xs, scale, strict=True)]
        return [loft(rings, shine), box([0.8 * length, 0.5, 0.05], [middle, 0, floor + 2 * radius + 0.03], shine)]
    steel, n = cloth(_LABEL, rng), 40
    tall, f = 2.6, np.linspace(span[0], span[1], n)
    wave = half - 0.03 * ((np.arange(n) // 2) % 2)
    corners = ((1, floor), (1, floor + tall), (-1, floor + tall), (-1, floor))
    ribbed = np.stack([np.stack([f, side * wave, np.full(n, z)], axis=1) for side, z in corners], axis=1)
    return [loft(ribbed, steel), *_contour(rng, span, half, floor - 0.03)]


def articulated_lorry(rng: np.random.Generator) -> Mesh:
    """Return a tractor with a semi-trailer, slightly bent at the joint."""
    half, length = 1.25, rng.uniform(14.0, 16.5)
    rear, front, radius, floor = -length / 2, length / 2, 0.5, rng.uniform(1.1, 1.25)
    parts, wall = _cab(rng, front, half * 0.99, rng.uniform(2.9, 3.8), bonnet=0.0)
    steer = front - 1.35
    parts += _running_gear(rng, [steer - rng.uniform(3.5, 3.8), steer], steer, half, radius)
    dark = tinted((0.05, 0.05, 0.05), _LABEL, 0.18, rng)
    parts.append(box([6.0 - (front - wall), 0.9, 0.3], [(wall + front - 6.0) / 2, 0, 0.85], dark))
    pivot = steer - 3.4
    span = (rear, wall - rng.uniform(0.35, 0.7))
    behind = _trailer(rng, span, half, floor)
    behind += _running_gear(rng, [rear + x for x in (1.4, 2.7, 4.0)], np.nan, half, radius)
    behind += _frame(rng, (rear + 0.05, pivot), floor, half)
    joint = [pivot, 0.0, 0.0]
    bent = join(behind).moved(np.negative(joint)).moved(joint, yaw=rng.normal(0, 0.03))
    return join([*parts, bent])
