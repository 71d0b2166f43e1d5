"""Traffic lights: the road is along +x; mast arms and pedestrian signals point there.

Signals for vehicles face +y, towards the traffic on that side of the road in right-hand traffic.
"""

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.materials import SIGN, retroreflective
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, polygon, tube
from mlsroad_pipeline.simulation.objects.parts import (
    arm,
    grid_skin,
    leaned,
    luminaire,
    mast,
    metal,
    panel,
    rectangle,
    tinted,
)
from mlsroad_pipeline.simulation.objects.traffic_signs import sign_plate

_COLOURS = ((0.4, 0.04, 0.03), (0.45, 0.3, 0.03), (0.04, 0.35, 0.12))


def _visor(radius: float, length: float, surface: Surface) -> Mesh:
    """Return the upper half of a tube along x that shades a lens."""
    turn = np.linspace(-0.15 * np.pi, 1.15 * np.pi, 7)
    rim = np.stack([0 * turn, radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    return grid_skin(np.stack([rim, rim + np.array([length, 0, -0.02])]), [surface])


def _head(rng: np.random.Generator, housing: Surface, *, lenses: int, size: float) -> Mesh:
    """Return a signal head with lenses one above the other, its middle at the origin, facing +x."""
    pitch = 1.18 * size
    tall = lenses * pitch
    parts = [box([0.55 * size, 1.12 * size, tall], [-0.28 * size, 0, 0], housing, taper=rng.uniform(0.95, 1.0))]
    colours = _COLOURS if lenses == 3 else _COLOURS[::2]
    deep = rng.uniform(0.35, 0.8) * size
    for k, colour in enumerate(colours[:lenses]):
        z = tall / 2 - (k + 0.5) * pitch
        lens = Surface(TAXONOMY["traffic_light"], colour, float(rng.uniform(0.2, 0.45)))
        parts.append(panel(polygon(12, 0.46 * size), lens, lens, [0.01, 0, z]))
        parts.append(_visor(0.5 * size, deep, housing).moved([0, 0, z]))
    return join(parts)


def _framed(rng: np.random.Generator, housing: Surface, *, lying: bool = False) -> Mesh:
    """Return a vehicle signal, some with a target board, some horizontal."""
    head = _head(rng, housing, lenses=3, size=float(rng.choice([0.21, 0.3])) * rng.uniform(0.95, 1.05))
    if rng.random() < 0.35:
        low, high = head.vertices.min(axis=0), head.vertices.max(axis=0)
        white = retroreflective(SIGN.white, "traffic_light", rng)
        edge = panel(rectangle(high[1] - low[1] + 0.3, high[2] - low[2] + 0.3), white, housing, [-0.02, 0, 0])
        inner = panel(rectangle(high[1] - low[1] + 0.2, high[2] - low[2] + 0.2), housing, housing, [-0.013, 0, 0])
        head = join([edge, inner, head])
    return head.moved([0, 0, 0], roll=np.pi / 2) if lying else head


def _button(rng: np.random.Generator, radius: float) -> Mesh:
    skin = tinted(SIGN.yellow, "traffic_light", 0.35, rng)
    return box([0.1, 0.1, rng.uniform(0.15, 0.24)], [0, radius + 0.04, rng.uniform(0.95, 1.1)], skin)


def _pedestrian_head(rng: np.random.Generator, housing: Surface) -> Mesh:
    return _head(rng, housing, lenses=2, size=rng.uniform(0.2, 0.3))


def _side_head(rng: np.random.Generator, radius: float, z: float, yaw: float, housing: Surface, head: Mesh) -> Mesh:
    """Return a head on two brackets beside the mast."""
    out, aside = radius + rng.uniform(0.15, 0.25), float(rng.choice([-1, 1])) * rng.uniform(0.0, 0.12)
    parts = [head.moved([out, aside, z])]
    half = 0.4 * float(np.ptp(head.vertices[:, 2]))
    parts += [tube([[0, 0, z + dz], [out - 0.05, aside, z + dz]], 0.02, housing, sides=4) for dz in (-half, half)]
    return join(parts).moved([0, 0, 0], yaw=yaw)


def _post_signal(rng: np.random.Generator) -> Mesh:
    """Return a vehicle signal on a post, often with one for pedestrians."""
    skin, housing = metal("traffic_light", rng), tinted((0.03, 0.035, 0.03), "traffic_light", 0.15, rng, spread=0.4)
    height, radius = rng.uniform(2.8, 3.9), rng.uniform(0.045, 0.08)
    parts = [mast(rng, height, radius, skin)]
    head = _framed(rng, housing)
    level = height - 0.5 * float(np.ptp(head.vertices[:, 2]))
    parts.append(_side_head(rng, radius, level, np.pi / 2, housing, head))
    if rng.random() < 0.35:  # another for turning or opposite traffic
        yaw = float(rng.choice([-np.pi / 2, np.pi])) + rng.normal(0, 0.1)
        parts.append(_side_head(rng, radius, level - rng.uniform(0.0, 0.3), yaw, housing, _framed(rng, housing)))
    if rng.random() < 0.5:
        walk = _pedestrian_head(rng, housing)
        parts.append(_side_head(rng, radius, rng.uniform(2.2, 2.5), 0.0, housing, walk))
    if rng.random() < 0.2:
        plate, half = sign_plate(rng)
        parts.append(plate.moved([0, radius + 0.03, height + half], yaw=np.pi / 2))
        parts.append(tube([[0, 0, height - 0.1], [0, 0, height + 1.5 * half]], 0.6 * radius, skin, sides=6))
    return leaned(join([*parts, _button(rng, radius)]), rng, share=0.15)


def _lit_mast(rng: np.random.Generator, height: float, radius: float, skin: Surface) -> list[Mesh]:
    """Return a mast that extends above its signals to a street lamp, which has its own label."""
    top, reach, rise = height + rng.uniform(1.2, 3.0), rng.uniform(0.6, 2.2), rng.uniform(0.05, 0.5)
    steel, start = metal("light_pole", rng), np.array([0, 0, top - 0.1])
    head = luminaire(rng, start + np.array([reach, 0, rise]), steel, pitch=rng.uniform(0, 0.15))
    return [mast(rng, top, radius, skin), arm(start, reach, rise, 0.0, steel, 0.03), head]


def _mast_arm(rng: np.random.Generator) -> Mesh:
    """Return heads along an arm over the road and one on the mast, sometimes with signs or a lamp."""
    skin, housing = metal("traffic_light", rng), tinted((0.03, 0.035, 0.03), "traffic_light", 0.15, rng, spread=0.4)
    height, reach = rng.uniform(5.6, 7.2), rng.uniform(3.0, 8.0)
    radius, rise = 0.07 + 0.009 * reach + rng.uniform(0.0, 0.04), rng.uniform(0.0, 0.6)
    level = height - rng.uniform(0.1, 0.5)
    lit = rng.random() < 0.25
    parts = _lit_mast(rng, height, radius, skin) if lit else [mast(rng, height, radius, skin)]
    bend = float(rng.choice([0.0, 1.0]))
    parts.append(arm([0, 0, level], reach, rise, bend, skin, 0.6 * radius))
    lying, count = rng.random() < 0.2, int(rng.integers(1, 4))
    for f in np.linspace(0.98, 0.4, count) if count > 1 else [0.97]:
        head = _framed(rng, housing, lying=lying)
        lift = (1 - bend) * f + bend * np.sqrt(1 - (1 - f) ** 2)
        at = np.array([reach * f, 0.18, level + rise * lift])
        if not lying:
            at[2] -= rng.uniform(0.04, 0.35)
        parts.append(head.moved(at, yaw=np.pi / 2 + rng.normal(0, 0.05)))
        parts.append(tube([[at[0], 0, at[2]], [at[0], 0.1, at[2]]], 0.04, housing, sides=4))
        parts.append(tube([[at[0], 0, level + rise * lift], [at[0], 0, at[2]]], 0.03, housing, sides=4) if not lying
                     else box([0.1, 0.1, 0.12], [at[0], 0.05, at[2]], housing))  # fmt: skip
    if rng.random() < 0.4:
        plate, half = sign_plate(rng, str(rng.choice(["round", "square", "rectangle"])))
        x = 0.25 * reach
        parts.append(plate.moved([x, 0.08, level + 0.1 * rise - 0.1 - half], yaw=np.pi / 2))
    if rng.random() < 0.7:
        head = _framed(rng, housing)
        parts.append(_side_head(rng, radius, rng.uniform(2.6, 3.3), np.pi / 2, housing, head))
    if rng.random() < 0.4:
        walk = _pedestrian_head(rng, housing)
        parts += [_side_head(rng, radius, rng.uniform(2.2, 2.5), 0.0, housing, walk), _button(rng, radius)]
    return leaned(join(parts), rng, share=0.1, limit=1.5)


def _pedestrian_signal(rng: np.random.Generator) -> Mesh:
    """Return a low post with a signal of two lenses that faces the road, sometimes with another along it."""
    skin, housing = metal("traffic_light", rng), tinted((0.03, 0.035, 0.03), "traffic_light", 0.15, rng, spread=0.4)
    height, radius = rng.uniform(2.6, 3.4), rng.uniform(0.042, 0.072)
    parts = [mast(rng, height, radius, skin), _button(rng, radius)]
    along = float(rng.choice([-1, 1])) * np.pi / 2  # the crossing of the other road
    for yaw in (0.0, along) if rng.random() < 0.35 else (0.0,):
        head = _pedestrian_head(rng, housing)
        parts.append(_side_head(rng, radius, height - rng.uniform(0.3, 0.5), yaw, housing, head))
    return leaned(join(parts), rng, share=0.15)


DESIGNS: tuple[Design, ...] = (
    Design("post_signal", "traffic_light", _post_signal, 0.6, 1.5),
    Design("mast_arm_signal", "traffic_light", _mast_arm, 0.6, 1.0),
    Design("pedestrian_signal", "traffic_light", _pedestrian_signal, 0.6, 1.0),
)
