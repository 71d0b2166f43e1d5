"""Plates of traffic signs: every common shape, with a drawn border, field and mark."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.simulation.model.materials import (
    SIGN_BLUE,
    SIGN_GREEN,
    SIGN_RED,
    SIGN_WHITE,
    SIGN_YELLOW,
    material,
    retroreflective,
)  # fmt: skip
from mlsroad_pipeline.simulation.model.meshes import Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import polygon, tube
from mlsroad_pipeline.simulation.objects.parts import panel, rectangle, rounded, tinted

SHAPES = ("round", "triangle", "yield", "square", "rectangle", "octagon", "diamond", "arrow")

Colour = tuple[float, float, float]

_ORANGE: Colour = (0.6, 0.22, 0.03)
# Border, field of each shape; without a field (None) all has the border's colour.
_COLOURS: dict[str, Sequence[tuple[Colour, Colour | None]]] = {
    "round": [(SIGN_RED, SIGN_WHITE), (SIGN_BLUE, None), (SIGN_RED, SIGN_BLUE), (SIGN_RED, SIGN_YELLOW)],
    "triangle": [(SIGN_RED, SIGN_WHITE), (SIGN_RED, SIGN_YELLOW)],
    "yield": [(SIGN_RED, SIGN_WHITE), (SIGN_RED, SIGN_YELLOW)],
    "square": [(SIGN_BLUE, None), (SIGN_WHITE, SIGN_BLUE), (SIGN_WHITE, SIGN_GREEN)],
    "rectangle": [(SIGN_BLUE, None), (SIGN_WHITE, None), (SIGN_WHITE, SIGN_GREEN), (SIGN_YELLOW, None)],
    "octagon": [(SIGN_WHITE, SIGN_RED), (SIGN_RED, None)],
    "diamond": [(SIGN_WHITE, SIGN_YELLOW), (SIGN_YELLOW, None), (_ORANGE, None)],
    "arrow": [(SIGN_WHITE, None), (SIGN_YELLOW, None), (SIGN_BLUE, None)],
}


def _outline(shape: str, rng: np.random.Generator) -> NDArray[np.float64]:
    size = rng.uniform(0.6, 0.9)
    if shape == "rectangle":
        long, short = rng.uniform(0.5, 1.0), rng.uniform(0.3, 0.6)
        return rounded(*((long, short) if rng.random() < 0.45 else (short, long)), 0.04)
    if shape == "arrow":
        return _arrow(rng.uniform(0.8, 1.4), rng.uniform(0.22, 0.4), right=rng.random() < 0.5)
    side = 1.12 * size / np.sqrt(3)  # of a triangle of 0.7 to 1 m
    return {
        "round": polygon(20, size / 2, start=np.pi / 20),
        "octagon": polygon(8, size / 2 / np.cos(np.pi / 8), start=np.pi / 8),
        "triangle": polygon(3, side, start=np.pi / 2),
        "yield": polygon(3, side, start=-np.pi / 2),
        "diamond": polygon(4, 0.68 * size, start=0.0),
        "square": rounded(0.85 * size, 0.85 * size, 0.05),
    }[shape]


def _arrow(long: float, high: float, *, right: bool) -> NDArray[np.float64]:
    tip = 0.6 * high
    left, body = -long / 2, long / 2 - tip
    outline = np.array([[left, -high / 2], [body, -high / 2], [long / 2, 0], [body, high / 2], [left, high / 2]])
    return outline if right else (outline * [-1, 1])[::-1]


def sign_plate(rng: np.random.Generator, shape: str | None = None) -> tuple[Mesh, float]:
    """Return the plate of a sign, its middle at the origin, facing +x, and half its height, metres.

    Without a `shape`, one of `SHAPES` is drawn. Round plates and octagons are 0.6 to 0.9 m wide. The plate is
    retro-reflective beside its mark; every face is `traffic_sign`.
    """
    name = shape or str(rng.choice(SHAPES, p=[0.28, 0.15, 0.08, 0.12, 0.17, 0.06, 0.07, 0.07]))
    if name not in SHAPES:
        raise ParameterError(f"shape must be one of {', '.join(SHAPES)}, got {name!r}")
    outline = _outline(name, rng)
    middle = (outline.max(axis=0) + outline.min(axis=0)) / 2
    outline = outline - middle
    choices = _COLOURS[name]
    border, field = choices[int(rng.integers(len(choices)))]
    back = material("sign_back", "traffic_sign", rng)
    parts = [panel(outline, retroreflective(border, "traffic_sign", rng), back, [0, 0, 0])]
    inner = outline.mean(axis=0)
    if field is not None:
        margin = rng.uniform(0.68, 0.8) if name in ("round", "triangle", "yield") else rng.uniform(0.86, 0.94)
        sheet = retroreflective(field, "traffic_sign", rng)
        parts.append(panel((outline - inner) * margin + inner, sheet, sheet, [0.005, 0, 0]))
    parts += _marks(rng, outline, inner, field or border)
    return join(parts), float(np.ptp(outline[:, 1]) / 2)


def _marks(
    rng: np.random.Generator, outline: NDArray[np.float64], middle: NDArray[np.float64], field: Colour
) -> list[Mesh]:
    """Return bars and discs in place of symbols and letters."""
    dark = tinted((0.04, 0.04, 0.045), "traffic_sign", 0.12, rng)
    mark = dark if sum(field) > 0.9 else retroreflective(SIGN_WHITE, "traffic_sign", rng)
    # The largest box about the middle that fits an outline is half as wide where it has three or four corners.
    reach = np.abs(outline - middle).max(axis=0) * (0.5 if len(outline) < 5 else 1.0)
    parts = []
    for _ in range(int(rng.integers(0, 4))):
        size = rng.uniform([0.08, 0.06], [0.5, 0.35]) * reach
        at = middle + rng.uniform(-0.25, 0.25, 2) * reach
        shape = rectangle(2 * size[0], 2 * size[1]) if rng.random() < 0.7 else polygon(8, float(size.min()))
        parts.append(panel(shape, mark, mark, [0.01, at[0], at[1]]))
    return parts


def board(rng: np.random.Generator, width: float, height: float, colour: Colour, at: ArrayLike, yaw: float) -> Mesh:
    """Return a direction board with its middle at `at`, facing `yaw` radians counter-clockwise from +x.

    It has a border, lines of text and stiffeners behind; `colour` is that of its field, linear. Every face is
    `traffic_sign`.
    """
    back = material("sign_back", "traffic_sign", rng)
    light = retroreflective(SIGN_WHITE, "traffic_sign", rng)
    field = retroreflective(colour, "traffic_sign", rng)
    radius = 0.08 * min(width, height)
    parts = [
        panel(rounded(width, height, radius), light, back, [0, 0, 0]),
        panel(rounded(width - 0.08, height - 0.08, radius), field, field, [0.005, 0, 0]),
    ]
    ink: Surface = light if sum(colour) < 1.5 else tinted((0.04, 0.04, 0.05), "traffic_sign", 0.12, rng)
    lines = max(int(height / rng.uniform(0.35, 0.6)), 1)
    for k in range(lines):
        long = width * rng.uniform(0.35, 0.8)
        z = height * ((k + 0.5) / lines - 0.5)
        y = rng.uniform(-0.5, 0.5) * (0.85 * width - long)
        parts.append(panel(rectangle(long, 0.35 * height / lines), ink, ink, [0.01, y, z]))
    for z in (-0.3 * height, 0.3 * height):
        parts.append(tube([[-0.035, -0.48 * width, z], [-0.035, 0.48 * width, z]], 0.025, back, sides=4))
    return join(parts).moved(at, yaw=yaw)


BOARD_COLOURS: tuple[Colour, ...] = (SIGN_BLUE, SIGN_GREEN, SIGN_WHITE, SIGN_YELLOW)
"""Colours of the fields of direction boards."""
