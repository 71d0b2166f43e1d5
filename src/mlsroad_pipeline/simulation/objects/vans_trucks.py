"""Vans, pick-ups and buses, and the lorries of `trucks`: front along +x, wheels on z = 0."""

from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np

from mlsroad_pipeline.simulation.model.materials import car_paint, cloth, material
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, quads, tube
from mlsroad_pipeline.simulation.objects import trucks
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
from mlsroad_pipeline.simulation.objects.parts import loft, rounded, tinted

_BUS = "bus"


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
    cover, cushions = material("seat", _BUS, rng), []
    for x in rows:
        for side in (-1, 1):
            y, z = side * 0.66 * half, floor + 0.48
            parts.append(box([0.1, 0.85, 0.7], [x - 0.2, y, z + 0.33], cover))
            cushions += [[x + dx, y + dy, z] for dx, dy in ((-0.2, -0.42), (0.25, -0.42), (0.25, 0.42), (-0.2, 0.42))]
    parts.append(quads(np.reshape(cushions, (-1, 4, 3)), cover))
    rail = material("galvanised", _BUS, rng)
    parts += [tube([[x, 0.25, floor], [x, 0.25, height - 0.15]], 0.018, rail, sides=3) for x in rows[1::3]]
    return body, parts


def _skins(rng: np.random.Generator) -> tuple[Surface, Surface, Surface]:
    dark = tinted((0.03, 0.03, 0.03), _BUS, 0.14, rng, spread=0.3)
    return car_paint(_BUS, rng), material("glass", _BUS, rng), dark


def _face(
    rng: np.random.Generator, body: Body, measures: tuple[float, float, float, float], dark: Surface
) -> list[Mesh]:
    """Return the front: mirrors on arms, sign, driver's seat, lamps."""
    half, height, clear, belt = measures
    front = body.top[-1][0]
    lit = tinted((0.5, 0.35, 0.05), _BUS, 0.3, rng, spread=0.3)
    parts = [box([0.05, 1.5 * half, 0.24], [front - 0.12, 0, height - 0.16], lit)]
    parts += mirrors(rng, body, front + 0.05, height - rng.uniform(0.5, 1.0), 0.2, dark)
    parts += seats(_BUS, rng, [front - 1.5], [0.6], clear + 0.55, 0.9)
    parts.append(steering_wheel(_BUS, [front - 0.85, 0.6, belt + 0.05], rng))
    parts.append(box([0.35, 1.5 * half, 0.3], [front - 0.4, 0.1, belt - 0.2], dark))
    parts += lamps(rng, body, _BUS, front=clear + 0.35, rear=None)
    if rng.random() < 0.5:  # air conditioning
        size = rng.uniform([1.5, 1.2, 0.15], [3.0, 1.9, 0.3])
        parts.append(box(size, [rng.uniform(-1.5, 1.0), 0, height + size[2] / 2], cloth(_BUS, rng), taper=0.9))
    return parts


def _measures(rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Return half width, height, ground clearance and height of the belt line."""
    return rng.uniform(1.23, 1.275), rng.uniform(2.9, 3.25), rng.uniform(0.26, 0.36), rng.uniform(0.95, 1.3)


def _bus(rng: np.random.Generator) -> Mesh:
    """Return a city or country bus of 8.5 to 12.8 m."""
    length, measures, skins = rng.uniform(8.5, 12.8), _measures(rng), _skins(rng)
    rear, front = -length / 2, length / 2
    axles = [rear + length * rng.uniform(0.2, 0.28), front - rng.uniform(2.4, 2.8)]
    body, parts = _coach(rng, (rear, front), measures, skins, head=True, axles=axles)
    parts += wheels(rng, body, _BUS, width=0.3, steered=rng.normal(0, 0.06))
    parts += lamps(rng, body, _BUS, front=None, rear=measures[2] + 0.75, upright=True)
    return join([*parts, *_face(rng, body, measures, skins[2])])


def _articulated_bus(rng: np.random.Generator) -> Mesh:
    """Return a bus of two cars, somewhat bent at the bellows between them."""
    length, measures, skins = rng.uniform(17.2, 18.8), _measures(rng), _skins(rng)
    rear, front = -length / 2, length / 2
    joint = front - rng.uniform(9.6, 10.4)
    head, parts = _coach(
        rng, (joint + 0.6, front), measures, skins, head=True, axles=[joint + 1.9, front - rng.uniform(2.4, 2.8)]
    )
    tail, behind = _coach(rng, (rear, joint - 0.6), measures, skins, head=False, axles=[rear + rng.uniform(2.9, 3.4)])
    width = 0.3
    parts += wheels(rng, head, _BUS, width=width, steered=rng.normal(0, 0.06))
    behind += wheels(rng, tail, _BUS, width=width)
    behind += lamps(rng, tail, _BUS, front=None, rear=measures[2] + 0.75, upright=True)
    half, height, clear, _ = measures
    bend = rng.normal(0, 0.05)
    rubber, folds = material("rubber", _BUS, rng), 13
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


def _dark(label: str, rng: np.random.Generator) -> Surface:
    return tinted((0.03, 0.03, 0.03), label, 0.14, rng, spread=0.3)


def _cockpit(rng: np.random.Generator, label: str, dash: float, belt: float, floor: float, half: float) -> list[Mesh]:
    """Return dashboard, steering wheel and front seats."""
    dark = _dark(label, rng)
    return [
        box([0.5, 1.7 * half, 0.2], [dash, 0, belt - 0.12], dark),
        steering_wheel(label, [dash - 0.35, 0.42, belt], rng),
        *seats(label, rng, [dash - 0.95], [-0.42, 0.42], floor + 0.4, 0.9),
    ]


def _van(rng: np.random.Generator, *, glazed: bool) -> Mesh:
    """Return a delivery van, with a high roof or small with a box behind the seats, or one with windows all round."""
    size = rng.random()  # from the smallest to the largest
    length, width = 4.2 + 2.3 * size + rng.normal(0, 0.1), 1.76 + 0.26 * size + rng.normal(0, 0.02)
    height = 1.8 + 0.85 * size * rng.uniform(0.5, 1.1) + rng.normal(0, 0.03)
    half, rear, front = width / 2, -length / 2, length / 2
    clear, radius, belt = rng.uniform(0.18, 0.28), rng.uniform(0.31, 0.36), rng.uniform(0.98, 1.15)
    cowl = front - rng.uniform(0.75, 1.1)
    screen_top = cowl - rng.uniform(0.55, 0.9)
    nose = belt * rng.uniform(0.8, 0.92)
    top = [(rear, height - 0.12), (rear + 0.08, height - 0.04), (rear + 0.5, height), (screen_top, height - 0.02),
           (cowl, belt + 0.07), (front - 0.25, nose + 0.08), (front - 0.06, nose), (front, nose - 0.12)]  # fmt: skip
    line = [(rear, belt), (cowl, belt), (front - 0.25, nose + 0.02), (front - 0.06, nose - 0.04), (front, nose - 0.15)]
    shoulder = [(rear, rng.uniform(0.82, 0.9)), (screen_top, rng.uniform(0.82, 0.9)), (cowl, 0.84), (front, 0.82)]
    doors = [cowl - 0.35, cowl - rng.uniform(1.2, 1.35)]
    panes = [(doors[1], doors[0])]
    if glazed:
        edges = np.linspace(doors[1] - 0.1, rear + 0.15, int(rng.integers(2, 4)) + 1)
        panes += [(b + 0.05, a - 0.05) for a, b in pairwise(edges)]
    axles = (rear + length * rng.uniform(0.17, 0.22), front - rng.uniform(0.75, 0.95))
    body = Body(half, clear, top, line, shoulder, axles, radius, rounding=0.35, drawn_in=rng.uniform(0.06, 0.16),
                side_panes=panes, top_panes=[(screen_top + 0.03, cowl - 0.03)])  # fmt: skip
    paint = car_paint("van", rng)
    if rng.random() < 0.45:  # most firms' vans are white
        paint = tinted((0.75, 0.75, 0.74), "van", 0.55, rng, spread=0.05, kind=paint.kind)
    glass, dark = material("glass", "van", rng), _dark("van", rng)
    parts = [skin(body, paint, glass, dark), *rails(body, [(screen_top, cowl)], 0.04, paint)]
    parts += wheels(rng, body, "van", width=rng.uniform(0.2, 0.24), steered=rng.normal(0, 0.08))
    parts += _cockpit(rng, "van", cowl - 0.15, belt, clear, half)
    parts += mirrors(rng, body, cowl - 0.35, belt + 0.18, 0.14, dark)
    parts += lamps(rng, body, "van", front=nose - 0.02, rear=1.0 + 0.2 * size, upright=True)
    if glazed:
        rows = np.arange(cowl - 2.1, rear + 0.9, -0.85)
        parts += seats("van", rng, rows.tolist(), [-0.45, 0.0, 0.45], clear + 0.4, 0.9)
        parts += pillars(body, [a for a, _ in panes[1:]], 0.03, dark)
    else:
        wall = box([0.03, 1.6 * half, height - clear - 0.4], [cowl - 1.55, 0, (height + clear) / 2], dark)
        parts += [wall, *_rear_windows(rng, rear, half, belt, glass)]
    if rng.random() < 0.12:
        parts += _ladder(rng, body, (rear + 0.3, screen_top - 0.3), height)
    return join(parts)


def _rear_windows(rng: np.random.Generator, rear: float, half: float, belt: float, glass: Surface) -> list[Mesh]:
    """Return the panes of the rear doors of every second van."""
    if rng.random() >= 0.5:
        return []
    pane = [0.02, 0.55 * half, 0.4]
    return [box(pane, [rear - 0.006, side * 0.4 * half, belt + 0.35], glass) for side in (-1, 1)]


def _ladder(rng: np.random.Generator, body: Body, span: tuple[float, float], height: float) -> list[Mesh]:
    """Return a ladder on the bars of a roof rack."""
    metal = material("aluminium", "van", rng)
    reach, y = 0.78 * body.half, rng.uniform(-0.3, 0.1)
    parts = [tube([[x, -reach, height + 0.1], [x, reach, height + 0.1]], 0.02, metal, sides=4) for x in span]
    rungs = np.arange(span[0], span[1], 0.4)
    parts += [tube([[span[0], y + d, height + 0.16], [span[1], y + d, height + 0.16]], 0.025, metal, sides=4)
              for d in (0.0, 0.4)]  # fmt: skip
    return parts + [tube([[x, y, height + 0.16], [x, y + 0.4, height + 0.16]], 0.015, metal, sides=3) for x in rungs]


def _pickup(rng: np.random.Generator) -> Mesh:
    """Return a pick-up with one or two rows of seats and an open, covered or loaded bed."""
    length, half = rng.uniform(4.9, 5.8), rng.uniform(0.88, 1.0)
    height, clear, radius = rng.uniform(1.72, 1.95), rng.uniform(0.24, 0.32), rng.uniform(0.36, 0.42)
    rear, front = -length / 2, length / 2
    belt = height * rng.uniform(0.58, 0.63)
    cowl = front - length * rng.uniform(0.22, 0.27)
    screen_top = cowl - rng.uniform(0.55, 0.8)
    double = rng.random() < 0.65
    cab_end = screen_top - (rng.uniform(1.35, 1.6) if double else rng.uniform(0.85, 1.1))
    bed = cab_end - rng.uniform(0.1, 0.18)
    nose, side = belt * rng.uniform(0.88, 0.96), belt * rng.uniform(0.95, 1.02)
    top = [(rear, side - 0.01), (bed, side), (cab_end, height - 0.04), (screen_top, height), (cowl, belt + 0.07),
           (front - 0.25, nose + 0.06), (front - 0.05, nose), (front, nose - 0.15)]  # fmt: skip
    line = [(rear, side - 0.02), (bed, side - 0.01), (cab_end, belt), (cowl, belt - 0.01), (front - 0.25, nose),
            (front - 0.05, nose - 0.03), (front, nose - 0.2)]  # fmt: skip
    shoulder = [(rear, 0.9), (bed, 0.9), (cab_end, 0.78), (screen_top, 0.76), (cowl, 0.84), (front, 0.84)]
    doors = cowl - 0.3
    panes = [(doors - 1.05, doors)] + ([(cab_end + 0.08, doors - 1.15)] if double else [])
    panes = [(max(a, cab_end + 0.05), b) for a, b in panes if b - max(a, cab_end + 0.05) > 0.2]
    axles = (rear + length * rng.uniform(0.2, 0.24), front - length * rng.uniform(0.165, 0.19))
    tonneau = rng.random() < 0.3
    body = Body(half, clear, top, line, shoulder, axles, radius, rounding=0.3, drawn_in=0.1, side_panes=panes,
                top_panes=[(bed + 0.02, cab_end - 0.02), (screen_top + 0.03, cowl - 0.03)],
                open=() if tonneau else [(rear + 0.08, bed - 0.02)])  # fmt: skip
    paint, glass, dark = car_paint("truck", rng), material("glass", "truck", rng), _dark("truck", rng)
    parts = [skin(body, paint, glass, dark), *rails(body, [(screen_top, cowl), (bed, cab_end)], 0.035, paint)]
    parts += wheels(rng, body, "truck", width=rng.uniform(0.22, 0.28), steered=rng.normal(0, 0.1))
    parts += _cockpit(rng, "truck", cowl - 0.2, belt, clear, half)
    if double:
        parts += seats("truck", rng, [max(cowl - 2.0, cab_end + 0.4)], [-0.42, 0.42], clear + 0.42, 0.8)
    if not tonneau:
        floor, wall = clear + 0.42, 0.86 * half
        middle, long = (rear + bed) / 2 + 0.03, bed - rear - 0.12
        parts.append(box([long, 2 * wall, 0.03], [middle, 0, floor], dark))
        parts += [box([long, 0.03, side - floor], [middle, y, (side + floor) / 2], dark) for y in (-wall, wall)]
        if rng.random() < 0.35:
            parts += _load(rng, "truck", (rear + 0.2, bed - 0.2), wall, floor)
    parts += mirrors(rng, body, cowl - 0.35, belt + 0.12, 0.11, dark)
    return join([*parts, *lamps(rng, body, "truck", front=nose - 0.03, rear=side - 0.28, upright=True)])


def _load(rng: np.random.Generator, label: str, span: tuple[float, float], half: float, floor: float) -> list[Mesh]:
    """Return boxes and rolls on a floor."""
    parts = []
    for _ in range(int(rng.integers(2, 6))):
        size = rng.uniform(0.2, 0.7, 3)
        x = rng.uniform(span[0] + size[0] / 2, max(span[1] - size[0] / 2, span[0] + size[0] / 2 + 0.01))
        y = rng.uniform(-1, 1) * max(half - 0.75 * size[1], 0.01)
        hue = rng.uniform(0.05, 0.5, 3)
        skin_of_box = tinted((float(hue[0]), float(hue[1]), float(hue[2])), label, 0.35, rng)
        outline = np.column_stack([rounded(size[0], size[1], 0.05), np.zeros(12)])
        body = loft([outline, outline * rng.uniform(0.7, 1.0) + [0, 0, size[2]]], skin_of_box)
        parts.append(body.moved([x, y, floor], yaw=rng.uniform(-0.3, 0.3)))
    return parts


_LARGE: tuple[tuple[str, str, Callable[[np.random.Generator], Mesh], float, float], ...] = (
    ("box_truck", "truck", trucks.box_truck, 4.9, 0.8),
    ("flatbed_truck", "truck", trucks.flatbed_truck, 4.9, 0.4),
    ("tipper_truck", "truck", trucks.tipper_truck, 4.9, 0.4),
    ("articulated_lorry", "truck", trucks.articulated_lorry, 8.5, 0.3),
    ("bus", "bus", _bus, 6.6, 1.0),
    ("articulated_bus", "bus", _articulated_bus, 9.6, 0.3),
)

DESIGNS: tuple[Design, ...] = (
    Design("panel_van", "van", partial(_van, glazed=False), clearance=3.6, weight=2.0),
    Design("minibus", "van", partial(_van, glazed=True), clearance=3.6, weight=0.8),
    Design("pickup", "truck", _pickup, clearance=3.0, weight=1.2),
    *(Design(name, label, build, clearance=clear, weight=weight) for name, label, build, clear, weight in _LARGE),
)
