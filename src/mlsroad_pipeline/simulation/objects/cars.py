"""Cars: front along +x, wheels on z = 0; measures are those of market segments from small to luxury cars.

Every line of a body is drawn from a range of its kind: cars of one kind differ in length, height, rake of windscreen
and rear, belt line and wheels; none is a scaled copy of another.
"""

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from mlsroad_pipeline.simulation.model.materials import car_paint, cloth, material
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, tube
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

Range = tuple[float, float]


@dataclass(frozen=True)
class CarRanges:
    """Ranges of the measures of a kind of car."""

    length: Range  # Metres
    width: Range  # Metres
    height: Range  # Metres
    cowl: Range  # Lower and upper end of the windscreen, and of the rear window, as shares of the length from the front
    # screen_top, roof_end: lower and upper end of the windscreen, and of the rear window, as shares of the length from
    # the front
    screen_top: Range
    roof_end: Range
    tail: Range  # Lower and upper end of the windscreen, and of the rear window, as shares of the length from the front
    belt: Range = (0.60, 0.66)  # Height of the belt line over the total height
    deck: Range = (0.95, 1.08)  # Height of the tail below the rear window over that of the belt line
    # clear, radius: ground clearance and radius of the wheels, metres
    clear: Range = (0.14, 0.2)
    radius: Range = (0.29, 0.34)


_KINDS = {
    "sedan": CarRanges(
        (4.3, 5.0), (1.74, 1.92), (1.40, 1.50), cowl=(0.25, 0.29), screen_top=(0.40, 0.45), roof_end=(0.69, 0.75),
        tail=(0.83, 0.88),
    ),
    "hatchback": CarRanges(
        (3.6, 4.4), (1.65, 1.83), (1.43, 1.58), cowl=(0.2, 0.26), screen_top=(0.37, 0.43), roof_end=(0.86, 0.93),
        tail=(0.96, 0.99),
    ),
    "estate": CarRanges(
        (4.4, 4.95), (1.74, 1.9), (1.43, 1.54), cowl=(0.24, 0.28), screen_top=(0.38, 0.43), roof_end=(0.9, 0.95),
        tail=(0.97, 0.99),
    ),
    "suv": CarRanges(
        (4.2, 4.95), (1.8, 2.0), (1.6, 1.86), cowl=(0.23, 0.28), screen_top=(0.36, 0.42), roof_end=(0.88, 0.94),
        tail=(0.96, 0.99), belt=(0.58, 0.64), clear=(0.19, 0.26), radius=(0.34, 0.4),
    ),
    "minivan": CarRanges(
        (4.2, 4.95), (1.76, 1.95), (1.58, 1.8), cowl=(0.15, 0.2), screen_top=(0.33, 0.39), roof_end=(0.92, 0.96),
        tail=(0.98, 0.99),
    ),
    "convertible": CarRanges(
        (3.8, 4.6), (1.68, 1.85), (1.28, 1.4), cowl=(0.27, 0.32), screen_top=(0.42, 0.46), roof_end=(0.62, 0.68),
        tail=(0.76, 0.82),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class _Lines:
    """Measures of one car, x from its middle, metres."""

    rear: float
    front: float
    height: float
    belt: float
    cowl: float
    screen_top: float
    roof_end: float
    tail: float


def _draw(kind: CarRanges, rng: np.random.Generator) -> tuple[_Lines, Body]:
    """Return the measures of a car and its body without panes."""

    def value(name: str) -> float:
        return float(rng.uniform(*getattr(kind, name)))

    length, height = value("length"), value("height")
    front, rear = length / 2, -length / 2
    cowl, screen_top, roof_end, tail = (
        front - length * value(name) for name in ("cowl", "screen_top", "roof_end", "tail")
    )
    belt, clear, radius = height * value("belt"), value("clear"), value("radius")
    lines = _Lines(rear, front, height, belt, cowl, screen_top, roof_end, tail)
    nose, wedge, deck = belt * rng.uniform(0.76, 0.88), rng.uniform(0.0, 0.05), belt * value("deck")
    bumper = rng.uniform(0.05, 0.12)
    tail_z = deck * rng.uniform(0.93, 1.0)
    belt_line = [(rear, tail_z - 0.05), (rear + bumper, tail_z), (tail, deck), (roof_end, belt + wedge),
                 (cowl, belt - 0.02), (front - 0.3, nose + 0.08), (front - bumper, nose - 0.02),
                 (front, nose - rng.uniform(0.12, 0.24))]  # fmt: skip
    crown = rng.uniform(0.03, 0.07)
    middle = screen_top + rng.uniform(0.3, 0.6) * (roof_end - screen_top)
    top = [(rear, tail_z - 0.03), (rear + bumper, tail_z + 0.02), (tail, deck + 0.03),
           (roof_end, height - rng.uniform(0.02, 0.1)), (middle, height),
           (screen_top, height - rng.uniform(0.01, 0.05)),
           (cowl, belt + 0.02 + crown), (front - 0.3, nose + 0.08 + crown), (front - bumper, nose + 0.01),
           (front, nose - 0.1)]  # fmt: skip
    roof = rng.uniform(0.66, 0.78)
    shoulder = [(rear, 0.86), (tail, 0.84), (roof_end, roof), (screen_top, roof), (cowl, 0.82), (front, 0.8)]
    axles = (rear + length * rng.uniform(0.16, 0.215), front - length * rng.uniform(0.165, 0.2))
    body = Body(
        float(rng.uniform(*kind.width)) / 2, clear, sorted(top), sorted(belt_line), shoulder, axles, radius,
        rounding=rng.uniform(0.3, 0.7), drawn_in=rng.uniform(0.1, 0.22),
    )  # fmt: skip
    return lines, body


def _glazed(lines: _Lines, body: Body, rng: np.random.Generator, *, rear_pane: bool = True) -> tuple[Body, list[float]]:
    """Return the body with its panes, and the x of the pillars between the side panes."""
    begin = lines.cowl - rng.uniform(0.25, 0.5) * (lines.cowl - lines.screen_top)
    slope = lines.roof_end - lines.tail
    end = lines.roof_end - rng.uniform(0.1, 0.5) * slope if slope > 0.35 else lines.roof_end - 0.02
    doors = [begin, begin - rng.uniform(0.9, 1.1)]
    while doors[-1] - end > 1.1:
        doors.append(doors[-1] - rng.uniform(0.75, 1.0))
    if doors[-1] - end < 0.25:
        doors.pop()
    doors.append(end)
    panes = [(b + 0.04, a - 0.04) for a, b in pairwise(doors) if a - b > 0.15]
    screens = [(lines.screen_top + 0.02, lines.cowl - 0.02)]
    if rear_pane:
        screens.append((lines.tail + 0.25 * min(slope, 0.2), lines.roof_end - 0.02))
    if rng.random() < 0.1:  # glass roof
        screens.append((lines.roof_end + 0.3, lines.screen_top - 0.12))
    return replace(body, side_panes=panes, top_panes=screens), doors[1:-1]


def _inside(rng: np.random.Generator, lines: _Lines, body: Body, *, rows: int) -> list[Mesh]:
    """Return dashboard, steering wheel, seats and the shelf behind them."""
    dark = tinted((0.05, 0.05, 0.055), "car", 0.25, rng, spread=0.3)
    half, belt = body.half, lines.belt
    dash = lines.cowl - 0.2
    parts = [box([0.45, 1.7 * half, 0.18], [dash, 0, belt - 0.12], dark)]
    parts.append(steering_wheel("car", [dash - 0.35, 0.36 if rng.random() < 0.85 else -0.36, belt - 0.06], rng))
    driver, z = dash - rng.uniform(0.95, 1.1), body.clear + 0.28
    tall = max(min(lines.height - 0.12 - z, 0.95), 0.6)
    back = driver - rng.uniform(0.75, 0.9)
    parts += seats("car", rng, [driver], [-0.36, 0.36], z, tall)
    if rows > 1:
        parts += seats("car", rng, [back], [-0.42, 0.0, 0.42] if half > 0.9 else [-0.36, 0.36], z + 0.03, 0.88 * tall)
    if rows > 2:
        parts += seats("car", rng, [back - 0.8], [-0.36, 0.36], z + 0.06, 0.85 * tall)
    behind = back - 0.35 if rows > 1 else driver - 0.35
    if rows < 3 and behind - 0.1 > lines.rear + 0.3:
        middle, long = (behind + lines.rear + 0.25) / 2, behind - lines.rear - 0.25
        parts.append(box([long, 1.7 * half, 0.04], [middle, 0, belt - 0.1], dark))
    return parts


def _trim(rng: np.random.Generator, lines: _Lines, body: Body, paint: Surface) -> list[Mesh]:
    """Return lamps, plates, mirrors, grille and aerial."""
    dark = tinted((0.03, 0.03, 0.032), "car", 0.12, rng, spread=0.3)
    nose = dict(body.belt)[lines.front]
    tail = float(body.at(body.top, np.array([lines.rear + 0.05]))[0])
    upright = tail > 0.9 * lines.belt and lines.tail - lines.rear < 0.3 and rng.random() < 0.5
    level = tail - (0.22 if upright else 0.12) - rng.uniform(0.0, 0.1)
    parts = lamps(rng, body, "car", front=nose + 0.02, rear=level, upright=upright)
    parts += mirrors(rng, body, lines.cowl - rng.uniform(0.3, 0.45), lines.belt + 0.08, rng.uniform(0.06, 0.09), paint)
    size = rng.uniform([0.6, 0.1], [1.1, 0.22])
    parts.append(box([0.02, *size], [lines.front + 0.004, 0, body.clear + rng.uniform(0.22, 0.36)], dark))
    if rng.random() < 0.4:
        foot = [lines.roof_end + 0.15, 0, lines.height - 0.06]
        parts.append(tube([foot, [foot[0] - 0.15, 0, foot[2] + rng.uniform(0.1, 0.3)]], 0.012, dark, sides=3))
    return parts


def _closed(rng: np.random.Generator, *, kind: str) -> Mesh:
    """Return a car with a roof: skin, pillars, wheels, interior and attachments."""
    lines, bare = _draw(_KINDS[kind], rng)
    body, doors = _glazed(lines, bare, rng)
    paint, glass = car_paint("car", rng), material("glass", "car", rng)
    under = tinted((0.03, 0.03, 0.03), "car", 0.15, rng)
    dark = under if rng.random() < 0.5 else paint
    parts = [skin(body, paint, glass, under, roof=under if rng.random() < 0.07 else None)]
    parts += rails(body, [(lines.screen_top, lines.cowl), (lines.tail, lines.roof_end)], 0.032, paint)
    parts += pillars(body, doors, 0.03, dark)
    steered = rng.normal(0, 0.12) if rng.random() < 0.5 else 0.0
    parts += wheels(rng, body, "car", width=rng.uniform(0.18, 0.25), steered=steered)
    rows = 3 if kind == "minivan" and rng.random() < 0.5 else 2
    parts += [*_inside(rng, lines, body, rows=rows), *_trim(rng, lines, body, paint)]
    if kind in ("estate", "suv", "minivan") and rng.random() < 0.5:
        span = (lines.roof_end + 0.1, lines.screen_top - 0.1)
        parts += [bar.moved([0, 0, 0.06]) for bar in rails(body, [span], 0.018, under)]
    if kind != "sedan" and rng.random() < 0.05:
        parts.append(_roof_box(rng, (lines.roof_end + lines.screen_top) / 2, lines.height))
    return join(parts)


def _roof_box(rng: np.random.Generator, x: float, z: float) -> Mesh:
    skin_of_box = tinted((0.1, 0.1, 0.1), "car", 0.25, rng, spread=0.6)
    length, width, tall = rng.uniform([1.3, 0.6, 0.28], [2.1, 0.9, 0.42])
    section = np.column_stack([np.zeros(12), rounded(width, tall, 0.1)])
    scales, xs = (0.7, 1.0, 1.0, 0.6), np.array([-0.5, -0.42, 0.3, 0.5]) * length
    rings = [section * [1, s, s] + [at, 0, 0.12 + tall / 2] for s, at in zip(scales, xs, strict=True)]
    return loft(rings, skin_of_box).moved([x, 0, z])


def _convertible(rng: np.random.Generator) -> Mesh:
    """Return a car without a fixed roof: open, its top folded behind the seats, or closed with a cloth top."""
    lines, bare = _draw(_KINDS["convertible"], rng)
    paint, glass = car_paint("car", rng), material("glass", "car", rng)
    under = tinted((0.03, 0.03, 0.03), "car", 0.15, rng)
    top = cloth("car", rng)
    closed = rng.random() < 0.4
    body, _ = _glazed(lines, bare, rng, rear_pane=closed)
    if closed:
        parts = [skin(body, paint, glass, under, roof=top)]
        parts += rails(body, [(lines.screen_top, lines.cowl), (lines.tail, lines.roof_end)], 0.03, under)
    else:
        gap = (lines.tail - 0.05, lines.screen_top + 0.02)
        body = replace(body, side_panes=(), top_panes=[(lines.screen_top + 0.02, lines.cowl - 0.02)], open=(gap,))
        parts = [skin(body, paint, glass, under)]
        parts += rails(body, [(lines.screen_top + 0.02, lines.cowl)], 0.03, paint)
        across = [[lines.screen_top + 0.02, y, lines.height - 0.05] for y in (-0.62 * body.half, 0.62 * body.half)]
        parts.append(tube(across, 0.03, paint, sides=5))
        folded = box([0.4, 1.5 * body.half, 0.16], [lines.tail + 0.2, 0, lines.belt], top, taper=0.8)
        parts.append(folded)
    parts += wheels(rng, body, "car", width=rng.uniform(0.19, 0.25), steered=rng.normal(0, 0.1))
    return join([*parts, *_inside(rng, lines, body, rows=1), *_trim(rng, lines, body, paint)])


_WEIGHTS = {"sedan": 2.0, "hatchback": 3.0, "estate": 1.5, "suv": 2.5, "minivan": 0.8}

DESIGNS: tuple[Design, ...] = (
    *(Design(kind, "car", partial(_closed, kind=kind), 2.6, weight) for kind, weight in _WEIGHTS.items()),
    Design("convertible", "car", _convertible, clearance=2.4, weight=0.3),
)
