"""What carries something above the street: lamps, utility poles, wires, signs, lights. Local -y faces the road."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.classes import TAXONOMY
from mlsroad_pipeline.algorithms.simulation.materials import (
    SIGN_BLUE,
    SIGN_GREEN,
    SIGN_RED,
    SIGN_WHITE,
    SIGN_YELLOW,
    cloth,
    material,
    retroreflective,
)  # fmt: skip
from mlsroad_pipeline.algorithms.simulation.meshes import Mesh, Surface, box, ellipsoid, join, plate, polygon, tube

_UNDERGROUND = 0.3
LAMP_DESIGNS = ("arm", "curved", "double", "post_top", "banner")


def _up(z: float) -> NDArray[np.float64]:
    return np.array([0.0, 0.0, z])


def light_pole(rng: np.random.Generator, design: str) -> Mesh:
    """Return a street lamp of one of `LAMP_DESIGNS`; the design is the street's, the measures are its own.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its measures and colours.
    design : str
        One of `LAMP_DESIGNS`.

    Returns
    -------
    Mesh
        6 to 11 m high, a post top 4 to 5.5 m; arms reach towards -y, of a double lamp also towards +y. Every face is
        `light_pole`.
    """
    metal = material(str(rng.choice(["galvanised", "painted_metal"])), "light_pole", rng)
    lens = material("plastic", "light_pole", rng)
    post_top = design == "post_top"
    height = rng.uniform(3.4, 5.0) if post_top else rng.uniform(6.0, 10.5)
    radius = rng.uniform(0.055, 0.085) if post_top else rng.uniform(0.07, 0.11)
    lean = rng.normal(0, 0.008, 2) * height
    path = np.array([[0, 0, -_UNDERGROUND], [0, 0, 0], [0, 0, 0.9], [0, 0, 0.95], [lean[0], lean[1], height]])
    meshes = [tube(path, radius * np.array([1.5, 1.5, 1.45, 1.05, 0.6]), metal, sides=10)]
    meshes.append(box([4.2 * radius, 4.2 * radius, _UNDERGROUND + 0.05], [0, 0, 0.025 - _UNDERGROUND / 2], metal))
    top = path[-1]
    if post_top:
        meshes.append(ellipsoid(top + _up(0.2), [0.18, 0.18, 0.24], lens))
        return join([*meshes, tube([top + _up(0.38), top + _up(0.5)], [0.24, 0.02], metal)])
    for direction in (-1, 1) if design == "double" else (-1,):
        meshes += _arm(rng, top, direction, metal, curved=design in ("curved", "double"))
    if design == "banner":
        meshes += _banner(rng, height, radius)
    return join(meshes)


def _arm(
    rng: np.random.Generator, top: NDArray[np.float64], direction: int, metal: Surface, *, curved: bool
) -> list[Mesh]:
    reach, rise = rng.uniform(0.9, 2.4), rng.uniform(0.1, 0.7)
    f = np.linspace(0, 1, 7)
    lift = rise * (np.sin(f * np.pi / 2) if curved else f) - (0.3 * rise * f**4 if curved else 0)
    path = top + np.column_stack([0 * f, direction * reach * f, lift - 0.05])
    head = path[-1] + [0, direction * 0.25, -0.03]
    size = [rng.uniform(0.2, 0.34), rng.uniform(0.5, 0.75), rng.uniform(0.08, 0.16)]
    return [tube(path, np.linspace(0.04, 0.028, 7), metal, sides=6), box(size, head, metal, taper=0.8)]


def _banner(rng: np.random.Generator, height: float, radius: float) -> list[Mesh]:
    fabric = cloth("light_pole", rng)
    width, tall, low = rng.uniform(0.45, 0.7), rng.uniform(1.0, 1.6), 0.45 * height
    sheet = box([width, 0.01, tall], [radius + width / 2 + 0.05, 0, low + tall / 2], fabric)
    return [
        sheet,
        *(tube([[0, 0, z], [radius + width + 0.08, 0, z]], 0.012, fabric, sides=4) for z in (low, low + tall)),
    ]


def utility_pole(rng: np.random.Generator) -> tuple[Mesh, NDArray[np.float64]]:
    """Return a wooden or concrete pole with cross-arms, some with a transformer.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its measures and colours.

    Returns
    -------
    pole : Mesh
        About 9 m high, cross-arms along y; `utility_pole`, a tank on it `transformer`.
    hang : ndarray of shape (5, 3), float64
        Where its wires hang from, metres.
    """
    wood = material(str(rng.choice(["wood", "concrete"])), "utility_pole", rng)
    metal = material("galvanised", "utility_pole", rng)
    height, radius = 9.0 + rng.normal(0, 0.5), rng.uniform(0.12, 0.17)
    lean = rng.normal(0, 0.06, 2)
    path = np.array([[0, 0, -_UNDERGROUND], [0, 0, 0], [lean[0], lean[1], height]])
    meshes = [tube(path, radius * np.array([1.1, 1.05, 0.7]), wood, sides=10)]
    hang = []
    for level, reach in ((height - 0.25, 0.95), (height - 1.1, 0.7)):
        meshes.append(box([0.1, 2 * reach + 0.15, 0.12], [0.13, 0, level], wood))
        for y in (-reach, reach):
            meshes.append(tube([[0.13, y, level], [0.13, y, level + 0.22]], [0.045, 0.03], metal, sides=6))
            hang.append([0.13, y, level + 0.22])
    hang.append([0.16, 0.0, height - 2.4])
    if rng.random() < 0.35:
        tank = Surface(TAXONOMY["transformer"], (0.3, 0.31, 0.32), float(rng.uniform(0.25, 0.45)))
        meshes.append(
            tube([[-0.42, 0, height - 2.6], [-0.42, 0, height - 1.7]], rng.uniform(0.22, 0.3), tank, sides=10)
        )
        meshes.append(box([0.2, 0.1, 0.08], [-0.2, 0, height - 2.0], metal))
    return join(meshes), np.array(hang)


def wire(start: ArrayLike, end: ArrayLike, sag: float, radius: float, rng: np.random.Generator) -> Mesh:
    """Return a wire that hangs between two points as a parabola, `sag` metres below their chord at its middle.

    Parameters
    ----------
    start, end : array-like of shape (3,)
        Its ends, metres.
    sag : float
        Metres.
    radius : float
        Metres.
    rng : numpy.random.Generator
        Source of its colour.

    Returns
    -------
    Mesh
        24 straight pieces; every face is `wire`.
    """
    f = np.linspace(0, 1, 25)[:, None]
    path = np.asarray(start) + f * (np.asarray(end) - np.asarray(start))
    path[:, 2] -= 4 * sag * (f * (1 - f))[:, 0]
    return tube(path, radius, material("wire", "wire", rng), sides=4)


def sign_plate(rng: np.random.Generator) -> tuple[Mesh, float]:
    """Return a sign's plate, upright with its middle at the local origin, facing -y.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its shape, size and colours.

    Returns
    -------
    plate : Mesh
        Front, back and what is on it; every face is `traffic_sign`.
    half : float
        Half its height, metres.
    """
    size = rng.uniform(0.26, 0.42)
    back = material("sign_back", "traffic_sign", rng)
    shape = str(rng.choice(["round", "triangle", "yield", "rectangle", "square", "octagon"]))
    outlines = {
        "round": polygon(16, size), "octagon": polygon(8, size, start=np.pi / 8),
        "triangle": polygon(3, 1.25 * size, start=np.pi / 2), "yield": polygon(3, 1.25 * size, start=-np.pi / 2),
        "square": polygon(4, 1.25 * size, start=np.pi / 4),
        "rectangle": np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [rng.uniform(0.3, 1.0), rng.uniform(0.25, 0.45)],
    }  # fmt: skip
    outline = outlines[shape]
    inner: tuple[float, float, float] | None = SIGN_WHITE
    rim = SIGN_RED
    if shape == "octagon":
        inner = None
    elif shape in ("square", "rectangle") or (shape == "round" and rng.random() < 0.4):
        rim = [SIGN_BLUE, SIGN_GREEN, SIGN_YELLOW, SIGN_WHITE][int(rng.integers(4))]
        inner = None
    meshes = [plate(outline, retroreflective(rim, "traffic_sign", rng), back)]
    if inner is not None:
        face = retroreflective(inner, "traffic_sign", rng)
        meshes.append(plate(0.72 * outline, face, back, thickness=0.003).moved([0, -0.004, 0]))
    mark = Surface(TAXONOMY["traffic_sign"], (0.04, 0.04, 0.045), 0.12)
    bar = rng.uniform([0.08, 0.15], [0.25, 0.4]) * np.abs(outline).max()
    meshes.append(
        plate(np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * bar, mark, back, thickness=0.002).moved([0, -0.007, 0])
    )
    return join(meshes), float(np.ptp(outline[:, 1]) / 2)


def traffic_sign(rng: np.random.Generator) -> Mesh:
    """Return one or two plates on one post, or a wide one on two; the plates face local -y.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its posts, plates and measures.

    Returns
    -------
    Mesh
        2.3 to 3.3 m high; every face is `traffic_sign`.
    """
    metal = material("galvanised", "traffic_sign", rng)
    radius, height = rng.uniform(0.025, 0.038), rng.uniform(2.3, 3.3)
    meshes, top = [], height
    for _ in range(1 + int(rng.random() < 0.35)):
        sheet, half = sign_plate(rng)
        meshes.append(sheet.moved([0, -radius - 0.02, top - half], yaw=rng.normal(0, 0.08)))
        top -= 2 * half + 0.05
    lean = rng.normal(0, 0.012, 2) * height
    posts = (-0.3, 0.3) if rng.random() < 0.15 else (0.0,)
    meshes += [tube([[x, 0, -_UNDERGROUND], [x + lean[0], lean[1], height + 0.03]], radius, metal) for x in posts]
    return join(meshes)


def _signal_head(rng: np.random.Generator, centre: ArrayLike, metal: Surface) -> list[Mesh]:
    at = np.asarray(centre, dtype=np.float64)
    meshes = [box([0.3, 0.2, 0.95], at, metal)]
    for k, colour in enumerate([(0.4, 0.04, 0.03), (0.45, 0.3, 0.03), (0.04, 0.35, 0.12)]):
        lens = Surface(TAXONOMY["traffic_light"], colour, float(rng.uniform(0.2, 0.45)))
        place = at + np.array([0, -0.105, 0.3 - 0.3 * k])
        meshes.append(plate(polygon(12, 0.11), lens, lens).moved(place))
        meshes.append(tube([place + _up(0.1), place + np.array([0, -0.16, 0.1])], [0.1, 0.09], metal, sides=6))
    return meshes


def traffic_light(rng: np.random.Generator) -> Mesh:
    """Return a traffic light on a post, some with a mast arm over the road.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its measures and colours.

    Returns
    -------
    Mesh
        Mast arms reach towards -y; every face is `traffic_light`.
    """
    metal = material("painted_metal", "traffic_light", rng)
    height, radius = rng.uniform(3.1, 3.8), rng.uniform(0.05, 0.08)
    meshes = [*_signal_head(rng, [0, -0.2, rng.uniform(2.4, 2.7)], metal)]
    if rng.random() < 0.5:
        height = rng.uniform(5.5, 6.4)
        reach = rng.uniform(2.5, 4.5)
        meshes.append(tube([[0, 0, height - 0.2], [0, -reach, height + 0.15]], [0.055, 0.04], metal))
        meshes += _signal_head(rng, [0, -reach, height - 0.35], metal)
    meshes.append(tube([[0, 0, -_UNDERGROUND], [0, 0, height]], [1.2 * radius, 0.9 * radius], metal, sides=10))
    button = Surface(TAXONOMY["traffic_light"], SIGN_YELLOW, float(rng.uniform(0.2, 0.5)))
    return join([*meshes, box([0.1, 0.1, 0.18], [0, -radius - 0.04, 1.05], button)])
