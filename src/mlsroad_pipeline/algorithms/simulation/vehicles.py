"""Vehicles: every function draws one, front along +x, wheels on z = 0, with cabins that glass lets the beam into."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.simulation.design import draw_one
from mlsroad_pipeline.algorithms.simulation.materials import (
    SIGN_RED,
    SIGN_WHITE,
    car_paint,
    material,
    retroreflective,
)  # fmt: skip
from mlsroad_pipeline.algorithms.simulation.meshes import Mesh, Surface, box, join, quads, tube
from mlsroad_pipeline.algorithms.simulation.objects import bicycles, people

CAR_DESIGNS = ("sedan", "hatchback", "estate", "suv", "pickup")

# length, width, height, bonnet's and boot's share of the length, height of the waistline over the total height
_CAR = {
    "sedan": (4.6, 1.8, 1.45, 0.27, 0.20, 0.62),
    "hatchback": (4.0, 1.75, 1.48, 0.24, 0.05, 0.60),
    "estate": (4.7, 1.82, 1.47, 0.26, 0.03, 0.60),
    "suv": (4.5, 1.88, 1.70, 0.25, 0.04, 0.58),
    "pickup": (5.2, 1.9, 1.8, 0.24, 0.36, 0.60),
}


def _ring(x: float, width: float, low: float, high: float) -> list[list[float]]:
    """Return the corners of a body's cross-section, rounded inwards above and below."""
    half = width / 2
    middle = low + 0.45 * (high - low)
    one = [[x, 0.9 * half, low], [x, half, middle], [x, 0.97 * half, high - 0.04], [x, 0.86 * half, high]]
    return one + [[x, -y, z] for _, y, z in reversed(one)]


def _loft(rings: ArrayLike, surface: Surface) -> Mesh:
    """Return the skin over a row of cross-sections, closed at both ends and below."""
    sections = np.asarray(rings, dtype=np.float64)
    corners = []
    m = sections.shape[1]
    for a, b in pairwise(sections):
        corners += [[a[k], b[k], b[(k + 1) % m], a[(k + 1) % m]] for k in range(m)]
    for end in (sections[0], sections[-1]):
        corners += [[end[k], end[k + 1], end[m - 2 - k], end[m - 1 - k]] for k in range(m // 2 - 1)]
    return quads(corners, surface)


def _wheels(rng: np.random.Generator, axles: tuple[float, ...], width: float, radius: float, label: str) -> list[Mesh]:
    tyre, rim = material("rubber", label, rng), material("aluminium", label, rng)
    meshes = []
    for x in axles:
        for side in (-1, 1):
            y = side * (width / 2 - 0.11)
            meshes.append(tube([[x, y - 0.1, radius], [x, y + 0.1, radius]], radius, tyre, sides=16))
            outer = y + side * 0.102
            meshes.append(tube([[x, outer, radius], [x, outer + side * 0.006, radius]], 0.62 * radius, rim, sides=12))
    return meshes


def _cabin(
    low: NDArray[np.float64], high: NDArray[np.float64], widths: tuple[float, float], z: tuple[float, float],
    glass: Surface, body: Surface, pillars: int,
) -> list[Mesh]:  # fmt: skip
    """Return windows around, pillars between them and a roof; low and high are the x of rear and front below, above."""
    (wl, wh), (zl, zh) = widths, z
    below = np.array([[low[0], wl, zl], [low[1], wl, zl], [low[1], -wl, zl], [low[0], -wl, zl]])
    above = np.array([[high[0], wh, zh], [high[1], wh, zh], [high[1], -wh, zh], [high[0], -wh, zh]])
    panes = [[below[k], below[(k + 1) % 4], above[(k + 1) % 4], above[k]] for k in range(4)]
    meshes = [quads(panes, glass), quads(above, body), quads(above - np.array([0, 0, 0.03]), body)]
    for side in (0, 2):
        for f in np.linspace(0, 1, pillars):
            foot = below[side] + f * (below[side + 1] - below[side])
            head = above[side] + f * (above[side + 1] - above[side])
            meshes.append(tube([foot, head], 0.045 if 0 < f < 1 else 0.06, body, sides=4))
    return meshes


def _lights(rng: np.random.Generator, x: tuple[float, float], width: float, z: float, label: str) -> list[Mesh]:
    rear, front = retroreflective(SIGN_RED, label, rng), material("glass", label, rng)
    lamp = Surface(front.label, (0.6, 0.6, 0.58), 0.5)
    plate = retroreflective(SIGN_WHITE, label, rng)
    meshes = []
    for side in (-1, 1):
        y = side * (width / 2 - 0.24)
        meshes += [box([0.03, 0.22, 0.13], [x[0] - 0.005, y, z], rear)]
        meshes += [box([0.04, 0.26, 0.12], [x[1] + 0.005, y, z], lamp)]
    for end, sign in zip(x, (-1, 1), strict=True):
        meshes.append(box([0.01, 0.5, 0.11], [end + sign * 0.015, 0, z - 0.18], plate))
    return meshes


def car(rng: np.random.Generator, design: str | None = None) -> Mesh:
    """Return a car of one of `CAR_DESIGNS` (drawn where None) with dimensions of its own.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its measures and colours, and of the design where none is given.
    design : str, optional
        One of `CAR_DESIGNS`.

    Returns
    -------
    Mesh
        Every face is `car`.

    Raises
    ------
    KeyError
        If there is no such design.
    """
    name = design or str(rng.choice(CAR_DESIGNS))
    length, width, height, bonnet, boot, waist = np.array(_CAR[name]) * rng.uniform(0.94, 1.06, 6)
    paint, glass = car_paint("car", rng), material("glass", "car", rng)
    clearance, radius = rng.uniform(0.16, 0.24), rng.uniform(0.29, 0.36)
    rear, front = -length / 2, length / 2
    belt = waist * height
    nose = front - bonnet * length
    tail = rear + boot * length
    body = [
        _ring(rear, 0.86 * width, clearance + 0.12, belt * rng.uniform(0.86, 0.97)),
        _ring(rear + 0.12, 0.97 * width, clearance, belt),
        _ring(tail + 0.3, width, clearance, belt),
        _ring(nose - 0.3, width, clearance, belt),
        _ring(nose + 0.15, width, clearance, belt - 0.02),
        _ring(front - 0.25, 0.95 * width, clearance, belt * rng.uniform(0.8, 0.88)),
        _ring(front, 0.8 * width, clearance + 0.12, belt * 0.66),
    ]
    axles = (rear + 0.19 * length, front - 0.19 * length)
    meshes = [_loft(body, paint), *_wheels(rng, axles, width, radius, "car")]
    slant = rng.uniform(0.3, 0.6) if name != "sedan" else rng.uniform(0.5, 0.75)
    low, high = (
        np.array([tail, nose]),
        np.array([tail + slant * (name != "pickup") + 0.1, nose - rng.uniform(0.6, 0.85)]),
    )
    half = width / 2
    meshes += _cabin(low, high, (0.86 * half, 0.7 * half), (belt, height), glass, paint, 3)
    seat = material("seat", "car", rng)
    for x in np.linspace(low[0] + 0.7, low[1] - 0.9, 2 if name != "pickup" else 1):
        for y in (-0.36, 0.36):
            meshes.append(box([0.16, 0.46, height - belt - 0.18], [x, y, belt + 0.4 * (height - belt)], seat))
    for side in (-1, 1):
        meshes.append(box([0.14, 0.2, 0.13], [nose - 0.3, side * (half + 0.07), belt + 0.06], paint))
    return join([*meshes, *_lights(rng, (rear, front), width, 0.75 * belt, "car")])


def van(rng: np.random.Generator) -> Mesh:
    """Return a delivery van: a tall box with a short sloping nose.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its measures and colours.

    Returns
    -------
    Mesh
        4.7 to 6.2 m long; every face is `van`.
    """
    length, width, height = rng.uniform([4.7, 1.85, 1.95], [6.2, 2.05, 2.75])
    paint, glass = car_paint("van", rng), material("glass", "van", rng)
    rear, front, low = -length / 2, length / 2, rng.uniform(0.2, 0.3)
    cab = front - rng.uniform(1.0, 1.4)
    body = [_ring(rear, 0.97 * width, low, height - 0.03), _ring(cab - 0.35, width, low, height)]
    nose = [_ring(cab - 0.35, width, low, 1.15), _ring(front - 0.2, 0.95 * width, low, 1.0),
            _ring(front, 0.82 * width, low + 0.1, 0.8)]  # fmt: skip
    meshes = [_loft(body, paint), _loft(nose, paint), *_wheels(rng, (rear + 0.9, front - 0.85), width, 0.34, "van")]
    half = width / 2
    span = (np.array([cab - 0.35, front - 0.35]), np.array([cab - 0.35, cab - 0.05]))
    meshes += _cabin(*span, (0.9 * half, 0.82 * half), (1.05, height - 0.06), glass, paint, 2)
    meshes.append(box([0.18, 1.3, 0.8], [cab - 0.1, 0, 1.2], material("seat", "van", rng)))
    return join([*meshes, *_lights(rng, (rear, front), width, 0.8, "van")])


def bus(rng: np.random.Generator) -> Mesh:
    """Return a city bus with a row of windows on each side and seats behind them.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its measures and colours.

    Returns
    -------
    Mesh
        9.5 to 12.2 m long; every face is `bus`.
    """
    length, width, height = rng.uniform([9.5, 2.45, 2.95], [12.2, 2.55, 3.2])
    paint, glass = car_paint("bus", rng), material("glass", "bus", rng)
    rear, front = -length / 2, length / 2
    lower = [
        _ring(rear, 0.97 * width, 0.32, 1.2),
        _ring(front - 0.1, width, 0.3, 1.2),
        _ring(front, 0.93 * width, 0.35, 1.15),
    ]
    half = width / 2
    span = np.array([rear + 0.02, front - 0.05])
    meshes = [_loft(lower, paint), *_wheels(rng, (rear + 2.6, front - 2.5), width, 0.48, "bus")]
    meshes += _cabin(
        span, span + np.array([0.05, -0.12]), (0.99 * half, 0.95 * half), (1.18, height - 0.25), glass, paint, 7
    )
    meshes.append(box([length - 0.15, 0.96 * width, 0.26], [0, 0, height - 0.13], paint))
    seat = material("seat", "bus", rng)
    for x in np.arange(rear + 1.2, front - 1.6, 0.85):
        for y in (-0.8, 0.8):
            meshes.append(box([0.12, 0.85, 0.75], [x, y, 1.25], seat))
    return join([*meshes, *_lights(rng, (rear, front), width, 0.9, "bus")])


def bicycle(rng: np.random.Generator) -> Mesh:
    """Return a parked bicycle.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its measures and colours.

    Returns
    -------
    Mesh
        On its stand, wheels along x; every face is `bicycle`.
    """
    return draw_one([d for d in bicycles.DESIGNS if d.name == "parked_bicycle"], rng)


def person(rng: np.random.Generator) -> Mesh:
    """Return a person on the way, with or without a bag.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of height, girth, step and clothes.

    Returns
    -------
    Mesh
        An adult or a child who looks along +x; every face is `person`.
    """
    return draw_one([d for d in people.DESIGNS if d.name in people.WALKERS], rng)


def cyclist(rng: np.random.Generator) -> Mesh:
    """Return a bicycle with its rider, labelled each on its own.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its measures and colours.

    Returns
    -------
    Mesh
        Faces are `bicycle` or `rider`.
    """
    return draw_one([d for d in bicycles.DESIGNS if d.name == "ridden_bicycle"], rng)
