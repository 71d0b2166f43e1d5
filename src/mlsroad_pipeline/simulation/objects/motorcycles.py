"""Motorcycles and scooters, parked on their stand or ridden.

Measures follow makers' data sheets: motorcycles 1.9 to 2.25 m long with wheels of 0.29 to 0.33 m radius and seats of
0.72 to 0.86 m, scooters 1.7 to 1.95 m with wheels of 0.2 to 0.26 m and seats of 0.74 to 0.8 m.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.bodies import Contacts, capsules, draw_build, helmeted, seat_rider
from mlsroad_pipeline.simulation.model.materials import car_paint, material
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, ellipsoid, tubes
from mlsroad_pipeline.simulation.objects.bicycles import wheel

_LABEL = "motorcycle"


def _common(rng: np.random.Generator, radius: float, base: float, tyre: float) -> tuple[list[Mesh], Surface, Surface]:
    """Return wheels with rims, and the surfaces of metal and rubber parts."""
    rubber, metal = material("rubber", _LABEL, rng), material("galvanised", _LABEL, rng)
    meshes = []
    for x in (-base / 2, base / 2):
        meshes.append(wheel([x, 0, radius], radius, tyre, rubber))
        disc = np.array([[[x, -0.4 * tyre, radius], [x, 0.4 * tyre, radius]]])
        meshes.append(tubes(disc, 0.62 * radius, metal, sides=8, closed=True))
    return meshes, metal, rubber


def _handlebar(
    rng: np.random.Generator, foot: np.ndarray, top: np.ndarray, half: float, metal: Surface, rubber: Surface
) -> list[Mesh]:
    """Return fork, bar, grips, lamp and mirrors."""
    y = np.array([0.0, 1.0, 0.0])
    back = rng.uniform(0.05, 0.14)
    grips = np.stack([top - half * y - [back, 0, 0], top + half * y - [back, 0, 0]])
    bar = np.stack([grips[0], top - 0.4 * half * y, top + 0.4 * half * y, grips[1]])
    fork = np.stack([np.stack([foot + k * y, top - [0, 0, 0.06] + k * y]) for k in (-0.09, 0.09)])
    meshes = [tubes(fork, 0.025, metal, sides=5), tubes(bar[None], 0.014, metal, sides=5)]
    meshes.append(
        tubes(np.stack([grips, grips + np.array([[0, 0.13, 0], [0, -0.13, 0]])], 1), 0.02, rubber, sides=5, closed=True)
    )
    high = rng.uniform(0.14, 0.24)
    for k in (-1, 1):
        stalk = np.stack([top + 0.6 * half * k * y, top + (0.75 * half * k) * y + [0.02, 0, high]])
        meshes.append(tubes(stalk[None], 0.008, rubber, sides=4))
        meshes.append(ellipsoid(stalk[1] + 0.03 * k * y, [0.02, 0.06, 0.045], rubber, rings=2, sides=6))
    return meshes


def _motorcycle(rng: np.random.Generator) -> tuple[Mesh, Contacts]:
    """Return a motorcycle and the contact points of its rider."""
    radius, base = rng.uniform(0.29, 0.33), rng.uniform(1.32, 1.55)
    meshes, metal, rubber = _common(rng, radius, base, rng.uniform(0.05, 0.075))
    paint = car_paint(_LABEL, rng)
    seat = rng.uniform(0.72, 0.85)
    top = np.array([base / 2 - rng.uniform(0.32, 0.42), 0, rng.uniform(0.98, 1.14)])
    meshes += _handlebar(rng, np.array([base / 2, 0, radius]), top, rng.uniform(0.32, 0.42), metal, rubber)
    tank = [0.18, 0, seat + rng.uniform(0.02, 0.1)]
    meshes.append(ellipsoid(tank, rng.uniform([0.24, 0.13, 0.13], [0.32, 0.18, 0.19]), paint, rings=4, sides=8))
    cushion = capsules(
        [[-0.02, 0, seat - 0.06]], [[-base / 2 + 0.12, 0, seat + rng.uniform(-0.03, 0.06)]], 0.11, 0.09, rubber
    )
    meshes += [cushion, box([rng.uniform(0.38, 0.5), rng.uniform(0.3, 0.42), 0.34], [0.06, 0, 0.42], metal, taper=0.8)]
    meshes.append(box([0.5, 0.22, 0.2], [-0.12, 0, 0.62], rubber))
    swing = np.stack([np.array([[-0.12, k, 0.42], [-base / 2, k, radius]]) for k in (-0.1, 0.1)])
    meshes.append(tubes(swing, 0.03, metal, sides=5))
    pipe = np.array([[0.25, -0.16, 0.4], [0.1, -0.18, 0.26], [-0.35, -0.19, 0.28], [-base / 2 - 0.1, -0.2, 0.4]])
    meshes.append(tubes(pipe[None], np.array([[0.025, 0.03, 0.045, 0.05]]), metal, sides=6, closed=True))
    lamp = top + np.array([0.1, 0, -0.14])
    meshes.append(ellipsoid(lamp, [0.09, 0.1, 0.1], material("aluminium", _LABEL, rng), rings=3, sides=7))
    if rng.random() < 0.4:
        meshes.append(ellipsoid(lamp + np.array([-0.02, 0, 0.02]), [0.2, 0.2, 0.3], paint, rings=4, sides=8))
    meshes += [_fender(np.array([x, 0, radius]), radius, paint) for x in (-base / 2, base / 2)]
    meshes += _luggage(rng, np.array([-base / 2 - 0.02, 0, seat + 0.02]), share=0.3)
    half = rng.uniform(0.19, 0.24)
    pegs = np.array([[-0.05, -half, 0.36], [-0.05, half, 0.36]])
    grips = top + np.array([[-0.1, -0.36, 0.0], [-0.1, 0.36, 0.0]])
    return join(meshes), Contacts(np.array([-0.22, 0, seat + 0.03]), pegs, grips)


def _fender(hub: np.ndarray, radius: float, paint: Surface) -> Mesh:
    turn = np.linspace(0.5, 2.6, 6)
    arc = np.column_stack([np.cos(turn), 0 * turn, np.sin(turn)]) * (radius + 0.03)
    return tubes((hub + arc)[None], 0.012, paint, sides=4, flatten=6.0)


def _luggage(rng: np.random.Generator, place: np.ndarray, *, share: float) -> list[Mesh]:
    if rng.random() > share:
        return []
    size = rng.uniform([0.3, 0.34, 0.26], [0.44, 0.5, 0.36])
    return [box(size, place + np.array([-0.06, 0, size[2] / 2 + 0.06]), material("plastic", _LABEL, rng), taper=0.85)]


def _scooter(rng: np.random.Generator) -> tuple[Mesh, Contacts]:
    """Return a scooter with a leg shield and a flat floor, and the contact points of its rider."""
    radius, base = rng.uniform(0.2, 0.26), rng.uniform(1.2, 1.36)
    meshes, metal, rubber = _common(rng, radius, base, rng.uniform(0.045, 0.06))
    paint = car_paint(_LABEL, rng)
    seat = rng.uniform(0.74, 0.8)
    top = np.array([base / 2 - rng.uniform(0.2, 0.27), 0, rng.uniform(0.98, 1.1)])
    meshes += _handlebar(rng, np.array([base / 2, 0, radius]), top, rng.uniform(0.3, 0.36), metal, rubber)
    foot = np.array([base / 2 - 0.26, 0, 0.3])
    lean = float(np.arctan2(top[0] - foot[0], top[2] - foot[2] - 0.15))
    width = rng.uniform(0.36, 0.46)
    shield = box([0.06, width, top[2] - 0.4], [0, 0, (top[2] - 0.4) / 2], paint, taper=0.75)
    meshes += [shield.moved(foot, pitch=lean), box([0.5, 0.36, 0.08], [0.06, 0, 0.3], rubber)]
    body = capsules([[-0.24, 0, 0.5]], [[-base / 2 - 0.08, 0, 0.62]], rng.uniform(0.19, 0.23), 0.13, paint, sides=8)
    meshes += [body, box([0.2, 0.3, 0.42], [-0.22, 0, 0.48], paint, taper=0.85)]
    saddle = capsules([[-0.14, 0, seat - 0.07]], [[-base / 2 - 0.05, 0, seat - 0.04]], 0.11, 0.1, rubber)
    meshes += [saddle, _fender(np.array([base / 2, 0, radius]), radius, paint)]
    meshes.append(ellipsoid(top + np.array([0.07, 0, 0.0]), [0.1, 0.14, 0.09], paint, rings=3, sides=7))
    meshes += _luggage(rng, np.array([-base / 2 - 0.08, 0, seat - 0.02]), share=0.45)
    if rng.random() < 0.25:
        clear = material("plastic", _LABEL, rng)
        meshes.append(
            box([0.01, 0.4, 0.42], [0, 0, 0.21], clear, taper=0.8).moved(top + np.array([0.05, 0, 0.03]), pitch=-0.35)
        )
    floor = np.array([[0.08, -0.12, 0.34], [0.08, 0.12, 0.34]])
    grips = top + np.array([[-0.09, -0.31, 0.0], [-0.09, 0.31, 0.0]])
    return join(meshes), Contacts(np.array([-0.3, 0, seat + 0.03]), floor, grips)


def _parked(rng: np.random.Generator, *, scooter: bool) -> Mesh:
    """Return a machine on its side stand."""
    mesh, _ = (_scooter if scooter else _motorcycle)(rng)
    prop = np.array([[[-0.1, 0.1, 0.3], [-0.05, 0.26, 0.02]]])
    stand = tubes(prop, 0.014, Surface(TAXONOMY[_LABEL], (0.05, 0.05, 0.05), 0.2), sides=4)
    mesh = join([mesh, stand]).moved([0, 0, 0], roll=-float(rng.uniform(0.02, 0.16)))
    return mesh.moved([0, 0, -float(mesh.vertices[:, 2].min())])


def _ridden(rng: np.random.Generator, *, scooter: bool) -> Mesh:
    """Return a machine with its rider; each has its own label."""
    mesh, contacts = (_scooter if scooter else _motorcycle)(rng)
    build = helmeted(draw_build(rng), rng, share=0.95)
    return join([mesh, seat_rider(rng, build, contacts)])


DESIGNS: tuple[Design, ...] = (
    Design("parked_motorcycle", "motorcycle", partial(_parked, scooter=False), 1.3, 1.0),
    Design("parked_scooter", "motorcycle", partial(_parked, scooter=True), 1.2, 1.5),
    Design("ridden_motorcycle", "rider", partial(_ridden, scooter=False), 1.3, 0.7),
    Design("ridden_scooter", "rider", partial(_ridden, scooter=True), 1.2, 0.8),
)
"""Every design of a motorcycle or scooter; the ridden ones are for the lanes."""
