"""Bicycles: parked upright, leaning, locked to a hoop or ridden; kick scooters; motorcycles, parked or ridden.

Measures follow bicycle fitting tables (wheels of 0.3 to 0.36 m radius, 0.2 to 0.26 m of folding ones, wheelbase 1.0 to
1.15 m, handlebars of 0.4 to 0.66 m) and makers' data sheets: motorcycles 1.9 to 2.25 m long with wheels of 0.29 to
0.33 m radius and seats of 0.72 to 0.86 m, scooters 1.7 to 1.95 m, wheels of 0.2 to 0.26 m, seats of 0.74 to 0.8 m.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.bodies import SHANK, THIGH, Contacts, capsules, draw_build, helmeted, seat_rider
from mlsroad_pipeline.simulation.model.materials import car_paint, material
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import Floats, blades, box, ellipsoid, tubes, unit

_MACHINE = "motorcycle"


class _Frame(NamedTuple):
    """Measures of a bicycle in its own plane, x forward and z up, metres."""

    radius: float
    rear: Floats
    front: Floats
    crank: Floats
    saddle: Floats
    head: Floats  # lower end of the steering tube
    stem: Floats  # joint of stem and handlebar
    low: bool  # whether it is a step-through frame


def wheel(centre: ArrayLike, radius: float, tyre: float, surface: Surface, *, points: int = 15) -> Mesh:
    """Return a tyre that rolls along x, of a radius to its outside and half a width `tyre`, metres."""
    turn = np.linspace(0, 2 * np.pi, points)
    ring = np.column_stack([np.cos(turn), 0 * turn, np.sin(turn)]) * (radius - tyre)
    mesh = tubes((np.asarray(centre) + ring)[None], tyre, surface, sides=4)
    # The seam: both ends of the tube share one cross-section.
    mesh.vertices[-4:] = mesh.vertices[:4]
    return mesh


def _measures(rng: np.random.Generator, leg: float) -> _Frame:
    """Draw a bicycle whose saddle fits a leg length from hip to sole, metres."""
    folding = rng.random() < 0.1
    radius = rng.uniform(0.2, 0.26) if folding else rng.uniform(0.3, 0.36)
    base = rng.uniform(1.0, 1.15)
    low = folding or rng.random() < 0.45
    at = np.array
    crank = at([-base / 2 + rng.uniform(0.41, 0.47), 0.0, rng.uniform(0.26, 0.31)])
    tilt = rng.uniform(1.22, 1.33)
    saddle = crank + (0.93 * leg - 0.14) * at([-np.cos(tilt), 0.0, np.sin(tilt)])
    front = at([base / 2, 0.0, radius])
    rake = rng.uniform(1.2, 1.3)
    up = at([-np.cos(rake), 0.0, np.sin(rake)])
    head = front + at([-0.05, 0.0, 0.0]) + (rng.uniform(0.3, 0.38) + 0.34 - radius) * up
    grip = min(saddle[2] + rng.uniform(-0.08, 0.22), head[2] + rng.uniform(0.28, 0.36))
    stem = head + (grip - head[2]) / np.sin(rake) * up + at([rng.uniform(0, 0.09), 0, 0])
    return _Frame(radius, at([-base / 2, 0.0, radius]), front, crank, saddle, head, stem, low)


def _steered(mesh: Mesh, frame: _Frame, angle: float) -> Mesh:
    """Rotate fork, front wheel and handlebar about the steering tube."""
    axis = unit(frame.stem - frame.head)
    v = mesh.vertices - frame.head
    turned = v * np.cos(angle) + np.cross(axis, v) * np.sin(angle) + (v @ axis)[:, None] * axis * (1 - np.cos(angle))
    return Mesh(turned + frame.head, mesh.faces, mesh.attributes)


def _bars(segments: list[tuple[Floats, Floats]], radius: float, surface: Surface) -> Mesh:
    return tubes(np.array(segments), radius, surface, sides=5)


def _spokes(rng: np.random.Generator, hub: Floats, radius: float, steel: Surface) -> Mesh:
    angle = np.arange(18) * 2 * np.pi / 18 + rng.uniform(0, 1)
    out = np.column_stack([np.cos(angle), 0 * angle, np.sin(angle)])
    return blades(np.tile(hub, (18, 1)), out, 0.95 * radius, 0.012, steel, rng, spread=0.02)


def _bicycle(rng: np.random.Generator, leg: float, steer: float) -> tuple[Mesh, Contacts]:
    """Return an upright bicycle and the contact points of its rider."""
    f = _measures(rng, leg)
    paint, tyre = car_paint("bicycle", rng), material("rubber", "bicycle", rng)
    paint = Surface(paint.label, paint.rgb, paint.reflectivity)
    steel = material("aluminium", "bicycle", rng)
    fat = rng.uniform(0.014, 0.028)
    side = np.array([0.0, 0.055, 0.0])
    seat_tube = f.saddle + 0.25 * (f.crank - f.saddle)
    top = f.head + 0.2 * (f.stem - f.head)
    joint = f.crank + 0.3 * (seat_tube - f.crank) if f.low else seat_tube
    stays = [(f.crank + k * side * 0.5, f.rear + k * side) for k in (-1, 1)]
    stays += [(seat_tube, f.rear + k * side) for k in (-1, 1)]
    frame = [_bars([(f.crank, seat_tube), (top, joint), (f.head, f.crank)], 0.02, paint), _bars(stays, 0.009, paint),
             _bars([(seat_tube, f.saddle)], 0.013, steel), wheel(f.rear, f.radius, fat, tyre),
             _spokes(rng, f.rear, f.radius, steel)]  # fmt: skip
    frame.append(box([0.25, rng.uniform(0.13, 0.2), 0.06], f.saddle + np.array([0.02, 0, -0.03]), tyre, taper=0.8))
    spin = rng.uniform(0, 2 * np.pi)
    arm = 0.17 * np.array([np.cos(spin), 0.0, np.sin(spin)])
    pedals = np.stack([f.crank + arm + [0, -0.12, 0], f.crank - arm + [0, 0.12, 0]])
    frame.append(_bars([(f.crank - side, pedals[0]), (f.crank + side, pedals[1])], 0.012, steel))
    frame += [box([0.09, 0.08, 0.02], p, tyre) for p in pedals]
    ring = wheel(f.crank - [0, 0.05, 0], 0.095, 0.008, steel, points=9)
    front, grips = _front(rng, f, paint, steel, tyre, fat)
    extras = _extras(rng, f, steel, tyre)
    mesh = join([*frame, ring, *extras, _steered(front, f, steer)])
    return mesh, Contacts(f.saddle, pedals, grips)


def _front(
    rng: np.random.Generator, f: _Frame, paint: Surface, steel: Surface, tyre: Surface, fat: float
) -> tuple[Mesh, Floats]:
    """Return the parts that turn with the handlebar, and its grips."""
    side = np.array([0.0, 0.055, 0.0])
    half, back = rng.uniform(0.2, 0.33), rng.uniform(-0.08, 0.08)
    rise = rng.uniform(-0.03, 0.09)
    grips = f.stem + np.array([[-back, -half, rise], [-back, half, rise]])
    knees = f.stem + np.array([[0, -0.5 * half, 0.6 * rise], [0, 0.5 * half, 0.6 * rise]])
    bar = np.stack([grips[0], *knees, grips[1]])
    ends = grips + np.array([[0.0, 0.12, -0.005], [0.0, -0.12, -0.005]])
    meshes = [_bars([(f.head, f.front + k * side) for k in (-1, 1)], 0.012, paint),
              _bars([(f.head, f.stem)], 0.018, paint), tubes(bar[None], 0.013, steel, sides=5),
              tubes(np.stack([grips, ends], 1), 0.018, tyre, sides=5),
              wheel(f.front, f.radius, fat, tyre), _spokes(rng, f.front, f.radius, steel)]  # fmt: skip
    if rng.random() < 0.3:
        size = rng.uniform([0.22, 0.26, 0.18], [0.32, 0.38, 0.28])
        centre = f.stem + np.array([0.06 + size[0] / 2, 0, -0.16])
        meshes.append(box(size, centre, material("wood", "bicycle", rng), taper=1.15))
    return join(meshes), grips


def _extras(rng: np.random.Generator, f: _Frame, steel: Surface, tyre: Surface) -> list[Mesh]:
    """Return mudguards, a carrier with its load, a child's seat or a bag."""
    meshes = []
    if rng.random() < 0.6:
        turn = np.linspace(0.6, 2.9, 8)
        arc = np.column_stack([np.cos(turn), 0 * turn, np.sin(turn)]) * (f.radius + 0.025)
        meshes.append(tubes((f.rear + arc)[None], 0.008, steel, sides=4, flatten=3.5))
    if rng.random() < 0.5:
        z = 2 * f.radius + 0.08
        length, sideways = rng.uniform(0.32, 0.42), np.array([0.0, 0.06, 0.0])
        meshes.append(box([length, 0.12, 0.02], [f.rear[0] - 0.03, 0, z], steel))
        props = np.array([[f.rear + k * sideways, [f.rear[0] - 0.1, 0.06 * k, z]] for k in (-1, 1)])
        meshes.append(tubes(props, 0.006, steel, sides=5))
        drawn = rng.random()
        if drawn < 0.15:
            meshes += [box([0.3, 0.28, 0.1], [f.rear[0] - 0.02, 0, z + 0.1], tyre),
                       box([0.08, 0.28, 0.45], [f.rear[0] - 0.18, 0, z + 0.3], tyre, taper=0.8)]  # fmt: skip
        elif drawn < 0.35:
            bag = car_paint("bicycle", rng)
            bag = Surface(bag.label, bag.rgb, bag.reflectivity)
            meshes += [box([0.3, 0.12, 0.32], [f.rear[0] - 0.05, k, z - 0.17], bag) for k in (-0.12, 0.12)]
    return meshes


def _parked(rng: np.random.Generator, *, lean: tuple[float, float], stand: bool = False, hoop: bool = False) -> Mesh:
    """Return a bicycle without rider, tilted towards +y or -y."""
    leg = rng.uniform(0.68, 0.92)
    mesh, _ = _bicycle(rng, leg, rng.normal(0.0, 0.35))
    roll = rng.uniform(*lean) * float(rng.choice([-1.0, 1.0]))
    if stand:
        foot = np.array([-0.12, -0.22 * np.sign(-roll), 0.0])
        prop = np.stack([np.array([-0.1, 0.0, 0.27]), foot + np.array([0, 0.0, 0.02])])
        mesh = join([mesh, tubes(prop[None], 0.01, material("aluminium", "bicycle", rng), sides=4)])
    mesh = mesh.moved([0, 0, 0], roll=roll)
    mesh = mesh.moved([0, 0, -float(mesh.vertices[:, 2].min())])
    if not hoop:
        return mesh
    high, wide = rng.uniform(0.75, 0.95), rng.uniform(0.55, 0.9)
    turn = np.linspace(0, np.pi, 8)
    bend = np.column_stack([-np.cos(turn) * wide / 2, 0 * turn, high - 0.2 + 0.2 * np.sin(turn)])
    path = np.concatenate([[[-wide / 2, 0, -0.1]], bend, [[wide / 2, 0, -0.1]]])
    steel = material("galvanised", "other_object", rng)
    beside = [rng.uniform(-0.1, 0.1), 0.16 * float(rng.choice([-1.0, 1.0])), 0.0]
    return join([mesh, tubes((path + beside)[None], rng.uniform(0.02, 0.03), steel, sides=6)])


def _ridden(rng: np.random.Generator) -> Mesh:
    """Return a bicycle with its rider; each has its own label."""
    build = helmeted(draw_build(rng), rng, share=0.4)
    leg = (THIGH + SHANK + 0.04) * build.height
    mesh, contacts = _bicycle(rng, leg, rng.normal(0.0, 0.03))
    return join([mesh, seat_rider(rng, build, contacts)])


def _kick_scooter(rng: np.random.Generator) -> Mesh:
    """Return a kick scooter on its stand."""
    label = "other_vehicle"
    paint, rubber = car_paint(label, rng), material("rubber", label, rng)
    paint = Surface(TAXONOMY[label], paint.rgb, paint.reflectivity)
    radius, base, high = rng.uniform(0.08, 0.14), rng.uniform(0.75, 0.95), rng.uniform(0.95, 1.2)
    front, rear = np.array([base / 2, 0, radius]), np.array([-base / 2, 0, radius])
    top = front + np.array([-0.22 * high, 0, high - radius])
    half, neck = rng.uniform(0.2, 0.26), np.array([base / 2 - 0.25, 0, radius + 0.05])
    parts = [wheel(front, radius, 0.03, rubber, points=11), wheel(rear, radius, 0.03, rubber, points=11),
             box([base - radius, 0.15, rng.uniform(0.05, 0.1)], [-0.04, 0, radius + 0.04], paint),
             _bars([(front, top), (front - np.array([0.06, 0, -0.04]), neck)], 0.024, paint),
             _bars([(top + np.array([0, -half, 0]), top + np.array([0, half, 0]))], 0.016, rubber),
             box([0.05, 0.06, 0.08], top + np.array([0.04, 0, -0.06]), rubber)]  # fmt: skip
    mesh = join(parts).moved([0, 0, 0], roll=float(rng.normal(0, 0.07)))
    return mesh.moved([0, 0, -float(mesh.vertices[:, 2].min())])


def _common(rng: np.random.Generator, radius: float, base: float, tyre: float) -> tuple[list[Mesh], Surface, Surface]:
    """Return wheels with rims, and the surfaces of metal and rubber parts."""
    rubber, metal = material("rubber", _MACHINE, rng), material("galvanised", _MACHINE, rng)
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
    paint = car_paint(_MACHINE, rng)
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
    meshes.append(ellipsoid(lamp, [0.09, 0.1, 0.1], material("aluminium", _MACHINE, rng), rings=3, sides=7))
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
    return [box(size, place + np.array([-0.06, 0, size[2] / 2 + 0.06]), material("plastic", _MACHINE, rng), taper=0.85)]


def _scooter(rng: np.random.Generator) -> tuple[Mesh, Contacts]:
    """Return a scooter with a leg shield and a flat floor, and the contact points of its rider."""
    radius, base = rng.uniform(0.2, 0.26), rng.uniform(1.2, 1.36)
    meshes, metal, rubber = _common(rng, radius, base, rng.uniform(0.045, 0.06))
    paint = car_paint(_MACHINE, rng)
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
        clear = material("plastic", _MACHINE, rng)
        meshes.append(
            box([0.01, 0.4, 0.42], [0, 0, 0.21], clear, taper=0.8).moved(top + np.array([0.05, 0, 0.03]), pitch=-0.35)
        )
    floor = np.array([[0.08, -0.12, 0.34], [0.08, 0.12, 0.34]])
    grips = top + np.array([[-0.09, -0.31, 0.0], [-0.09, 0.31, 0.0]])
    return join(meshes), Contacts(np.array([-0.3, 0, seat + 0.03]), floor, grips)


def _parked_machine(rng: np.random.Generator, *, scooter: bool) -> Mesh:
    """Return a machine on its side stand."""
    mesh, _ = (_scooter if scooter else _motorcycle)(rng)
    prop = np.array([[[-0.1, 0.1, 0.3], [-0.05, 0.26, 0.02]]])
    stand = tubes(prop, 0.014, Surface(TAXONOMY[_MACHINE], (0.05, 0.05, 0.05), 0.2), sides=4)
    mesh = join([mesh, stand]).moved([0, 0, 0], roll=-float(rng.uniform(0.02, 0.16)))
    return mesh.moved([0, 0, -float(mesh.vertices[:, 2].min())])


def _ridden_machine(rng: np.random.Generator, *, scooter: bool) -> Mesh:
    """Return a machine with its rider; each has its own label."""
    mesh, contacts = (_scooter if scooter else _motorcycle)(rng)
    build = helmeted(draw_build(rng), rng, share=0.95)
    return join([mesh, seat_rider(rng, build, contacts)])


DESIGNS: tuple[Design, ...] = (
    Design("parked_bicycle", "bicycle", partial(_parked, lean=(0.03, 0.1), stand=True), 1.0, 2.0),
    Design("leaning_bicycle", "bicycle", partial(_parked, lean=(0.12, 0.26)), 1.0, 1.0),
    Design("hoop_bicycle", "bicycle", partial(_parked, lean=(0.0, 0.06), hoop=True), 1.0, 1.5),
    Design("ridden_bicycle", "rider", _ridden, 1.1, 3.0),
    Design("kick_scooter", "other_vehicle", _kick_scooter, 0.7, 0.5),
    Design("parked_motorcycle", "motorcycle", partial(_parked_machine, scooter=False), 1.3, 1.0),
    Design("parked_scooter", "motorcycle", partial(_parked_machine, scooter=True), 1.2, 1.5),
    Design("ridden_motorcycle", "rider", partial(_ridden_machine, scooter=False), 1.3, 0.7),
    Design("ridden_scooter", "rider", partial(_ridden_machine, scooter=True), 1.2, 0.8),
)
