"""People who stand, walk, run, sit, talk and carry things: capsules between the joints of a pose.

Segment lengths follow Drillis and Contini 1966; hip and knee angles of walking follow common gait charts (hip some 25
degrees either way, knee up to 60 degrees in swing).
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from mlsroad_pipeline.simulation import bodies
from mlsroad_pipeline.simulation.model.materials import cloth, material
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh, join
from mlsroad_pipeline.simulation.model.solids import Floats, box, tubes, unit

_SIDES = np.array([-1.0, 1.0])  # right, left
Angles = tuple[Floats, Floats, Floats, Floats]


def _pose(rng: np.random.Generator, build: bodies.Build, angles: Angles, *, lean: float) -> bodies.Skeleton:
    """Return the joints of a body from its hip, knee, shoulder and elbow angles, its lower foot on the ground."""
    thigh, knee, arm, elbow = angles
    h = build.height
    y = np.stack([0 * _SIDES, _SIDES, 0 * _SIDES], 1)
    hips = bodies.HIP * h * y

    def down(angle: Floats, outwards: float) -> Floats:
        return unit(np.stack([np.sin(angle), outwards * _SIDES, -np.cos(angle)], 1))

    knees = hips + bodies.THIGH * h * down(thigh, 0.02)
    ankles = knees + bodies.SHANK * h * down(thigh - knee, 0.02)
    up = np.array([np.sin(lean), 0.0, np.cos(lean)])
    chest = bodies.SPINE * h * up
    shoulders = chest + bodies.SHOULDER * h * build.girth**0.3 * y
    elbows = shoulders + bodies.UPPER_ARM * h * down(arm + lean, 0.18)
    inwards = np.where(elbow > 0.8, -0.45, 0.05)
    fore = np.stack([np.sin(arm + elbow), inwards * _SIDES, -np.cos(arm + elbow)], 1)
    wrists = elbows + bodies.FOREARM * h * unit(fore)
    flat = np.stack([np.cos(0.12 * _SIDES), np.sin(0.12 * _SIDES), 0 * _SIDES], 1)
    tilt = np.clip(thigh - knee, -1.0, 0.0) * (ankles[:, 2] > ankles[:, 2].min() + 0.03)
    feet = unit(flat + np.stack([0 * tilt, 0 * tilt, tilt], 1))
    nod = np.array([rng.uniform(0.0, 0.035), rng.normal(0, 0.01), 0.0]) * h
    crown = h - (bodies.SHANK + bodies.THIGH + bodies.ANKLE) * h
    head = up * max(crown - build.head, bodies.SPINE * h + 0.9 * build.head) + nod
    bones = bodies.Skeleton(hips, knees, ankles, shoulders, elbows, wrists, feet, head)
    return bones.moved([0.0, 0.0, bodies.ANKLE * h - ankles[:, 2].min()])


def _standing(rng: np.random.Generator) -> tuple[Angles, float]:
    """Return the angles of a standing person: arms down, folded, on the hips or at a telephone."""
    thigh, knee = rng.normal(0, 0.06, 2), np.abs(rng.normal(0, 0.07, 2))
    arm, elbow = rng.normal(0.02, 0.12, 2), rng.uniform(0.05, 0.4, 2)
    what = rng.random()
    if what < 0.2:
        arm, elbow = rng.uniform(0.2, 0.5, 2), rng.uniform(1.4, 1.9, 2)
    elif what < 0.45:
        k = int(rng.integers(2))
        arm[k], elbow[k] = rng.uniform(0.3, 0.8), rng.uniform(1.5, 2.3)
    return (thigh, knee, arm, elbow), float(rng.normal(0.02, 0.03))


def _walking(rng: np.random.Generator, *, run: bool = False) -> tuple[Angles, float]:
    """Return the angles at a moment of a step; arms swing against the legs."""
    phase = rng.uniform(0, 2 * np.pi) + np.array([0.0, np.pi])
    wide = rng.uniform(0.55, 0.85) if run else rng.uniform(0.3, 0.5)
    thigh = 0.05 + wide * np.sin(phase)
    swing = np.maximum(np.sin(phase - 2.4 + np.pi), 0.0)
    knee = 0.08 + (1.5 if run else 0.95) * swing * (0.5 + 0.5 * np.cos(phase))
    arm = -0.9 * wide * np.sin(phase) * rng.uniform(0.6, 1.1)
    elbow = np.full(2, 1.4 if run else rng.uniform(0.15, 0.6)) + 0.15 * np.maximum(arm, 0)
    return (thigh, knee, arm, elbow), float(rng.uniform(0.12, 0.25) if run else rng.uniform(0.0, 0.08))


def _talking(rng: np.random.Generator) -> tuple[Angles, float]:
    """Return the angles of a person who talks with gestures."""
    thigh, knee = rng.normal(0, 0.07, 2), np.abs(rng.normal(0, 0.1, 2))
    arm, elbow = rng.uniform(0.1, 0.7, 2), rng.uniform(0.5, 1.7, 2)
    return (thigh, knee, arm, elbow), float(rng.normal(0.04, 0.03))


def _person(
    rng: np.random.Generator, *, pose: Callable[..., tuple[Angles, float]], child: bool = False, bag: str = "any",
    sport: bool = False,
) -> Mesh:  # fmt: skip
    """Return a person in a pose with a `bag`, or any or none."""
    build = bodies.draw_build(rng, child=child)
    if sport:
        build = build._replace(clothes=("trousers", "shorts")[int(rng.integers(2))])
    angles, lean = pose(rng)
    if bag == "any":
        bag = ("none", "backpack", "shoulder", "hand")[int(rng.choice(4, p=[0.7, 0.1, 0.1, 0.1]))]
    if bag == "hand":
        angles[2][0], angles[3][0] = rng.normal(0, 0.06), rng.uniform(0.0, 0.15)
    bones = _pose(rng, build, angles, lean=lean)
    mesh = join([bodies.clothe(rng, bones, build, "person"), *_luggage(rng, bones, build, bag)])
    return mesh.moved([0.0, 0.0, -float(mesh.vertices[:, 2].min())])


def _luggage(rng: np.random.Generator, bones: bodies.Skeleton, build: bodies.Build, bag: str) -> list[Mesh]:
    """Return the luggage of a person."""
    h = build.height / 1.7
    textile = cloth("person", rng)
    chest = 0.4 * bones.hips.mean(axis=0) + 0.6 * bones.shoulders.mean(axis=0)
    if bag == "backpack":
        size = rng.uniform([0.14, 0.26, 0.34], [0.24, 0.36, 0.55]) * h
        return [box(size, chest - [0.1 * h * build.girth + size[0] / 2, 0, 0], textile, taper=0.85)]
    if bag == "shoulder":
        size = rng.uniform([0.22, 0.08, 0.18], [0.38, 0.14, 0.3]) * h
        side = float(rng.choice([-1.0, 1.0]))
        centre = bones.hips.mean(axis=0) + np.array([0, side * (0.2 * h * build.girth + size[1] / 2), 0.06])
        top = bones.shoulders[int(side > 0)] + [0, 0, 0.05]
        strap = np.stack([centre + np.array([0, 0, size[2] / 2]), top])
        return [box(size, centre, textile, taper=rng.uniform(0.7, 1.0)), tubes(strap[None], 0.012, textile, sides=3)]
    if bag == "hand":
        size = rng.uniform([0.25, 0.1, 0.25], [0.42, 0.22, 0.42]) * h
        hand = bones.wrists[0] - [0, 0, 0.08 * h]
        return [box(size, hand - [0, 0, 0.1 * h + size[2] / 2], textile, taper=0.9),
                tubes(np.stack([hand, hand - [0, 0, 0.12 * h]])[None], 0.01, textile, sides=3)]  # fmt: skip
    return []


def _with_suitcase(rng: np.random.Generator) -> Mesh:
    """Return a person who pulls a suitcase on wheels."""
    build = bodies.draw_build(rng)
    angles, lean = _walking(rng)
    angles[2][0], angles[3][0] = -0.45, 0.12
    bones = _pose(rng, build, angles, lean=lean)
    size = rng.uniform([0.2, 0.34, 0.5], [0.3, 0.48, 0.72])
    hand = bones.wrists[0] - [0.02, 0.0, 0.06]
    case = box(size, [0, 0, size[2] / 2], cloth("person", rng)).moved([0, 0, 0], pitch=-0.5)
    case = case.moved([hand[0] - 0.42, hand[1], 0.05 - case.vertices[:, 2].min()])
    top = case.vertices[case.vertices[:, 2].argsort()[-2:]].mean(axis=0)
    handle = tubes(np.stack([hand, top])[None], 0.014, material("aluminium", "person", rng), sides=4)
    wheels = [box([0.05, 0.03, 0.05], [case.vertices[case.vertices[:, 2].argmin(), 0], hand[1] + k, 0.026],
                  material("rubber", "person", rng)) for k in (-0.13, 0.13)]  # fmt: skip
    return join([bodies.clothe(rng, bones, build, "person"), case, handle, *wheels])


def _sitting(rng: np.random.Generator) -> Mesh:
    """Return a person on a stool, with hands on the knees or in the lap."""
    build = bodies.draw_build(rng)
    # Skirts and coats are not modelled over bent knees.
    build = build._replace(clothes={"trousers": "trousers", "coat": "trousers"}.get(build.clothes, "shorts"))
    h = build.height
    seat = 0.27 * h - rng.uniform(0.0, 0.05)
    y = np.stack([0 * _SIDES, _SIDES, 0 * _SIDES], 1)
    hips = bodies.HIP * h * y + [-0.18, 0, seat + 0.09 * build.girth]
    apart = rng.uniform(0.08, 0.2)
    ankles = np.stack([0.24 * h - 0.18 + rng.normal(0, 0.06, 2), apart * _SIDES, np.full(2, bodies.ANKLE * h)], 1)
    knees = bodies.bent_joint(hips, ankles, bodies.THIGH * h, bodies.SHANK * h, [0.6, 0.0, 1.0])
    lean = rng.uniform(-0.1, 0.35)
    up = np.array([np.sin(lean), 0.0, np.cos(lean)])
    middle = hips.mean(axis=0)
    shoulders = middle + bodies.SPINE * h * up + bodies.SHOULDER * h * y
    wrists = 0.3 * hips + 0.7 * knees + [0.0, 0.0, 0.09] + rng.normal(0, 0.02, (2, 3))
    elbows = (
        bodies.bent_joint(shoulders, wrists, bodies.UPPER_ARM * h, bodies.FOREARM * h, [-1.0, 0.0, -0.2]) + 0.04 * y
    )
    head = middle + (bodies.SPINE * h + 1.75 * build.head) * up + [0.03, 0, 0]
    feet = np.tile([1.0, 0.0, 0.0], (2, 1))
    body = bodies.clothe(
        rng, bodies.Skeleton(hips, knees, ankles, shoulders, elbows, wrists, feet, head), build, "person"
    )
    textile = cloth("person", rng)
    corner = 0.14 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) + [-0.2, 0, 0]
    legs = tubes(np.stack([1.1 * corner, corner + np.array([0, 0, seat - 0.02])], 1), 0.012, textile, sides=4)
    return join([body, legs, box([0.36, 0.36, 0.03], [-0.2, 0, seat - 0.02], textile)])


def conversation(rng: np.random.Generator) -> list[Mesh]:
    """Return two to four people, one mesh each, sometimes with a child, who talk in a ring about the origin."""
    n = int(rng.integers(2, 5))
    radius = rng.uniform(0.45, 0.6) + 0.12 * (n - 2)
    start = rng.uniform(0, 2 * np.pi)
    people = []
    for k in range(n):
        pose = _talking if rng.random() < 0.6 else _standing
        azimuth = start + 2 * np.pi * k / n + rng.normal(0, 0.12)
        who = _person(rng, pose=pose, child=k > 1 and rng.random() < 0.3)
        place = radius * rng.uniform(0.9, 1.15) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        people.append(who.moved(place, yaw=float(azimuth + np.pi + rng.normal(0, 0.25))))
    return people


WALKERS = ("walking_person", "person_with_backpack", "person_with_bag", "person_with_suitcase", "walking_child")
"""Names of the designs of walking people."""

DESIGNS: tuple[Design, ...] = (
    Design("standing_person", "person", partial(_person, pose=_standing), 0.6, 3.0),
    Design("walking_person", "person", partial(_person, pose=_walking), 0.9, 4.0),
    Design(
        "running_person", "person", partial(_person, pose=partial(_walking, run=True), bag="none", sport=True), 1.1, 0.3
    ),
    Design("talking_person", "person", partial(_person, pose=_talking), 0.6, 1.0),
    Design("person_with_backpack", "person", partial(_person, pose=_walking, bag="backpack"), 0.9, 0.7),
    Design("person_with_bag", "person", partial(_person, pose=_walking, bag="hand"), 0.9, 0.7),
    Design("person_with_suitcase", "person", _with_suitcase, 1.4, 0.2),
    Design("sitting_person", "person", _sitting, 0.8, 0.3),
    Design("standing_child", "person", partial(_person, pose=_standing, child=True), 0.5, 0.5),
    Design("walking_child", "person", partial(_person, pose=_walking, child=True), 0.8, 0.6),
)
