"""What stands about: bins, benches, bollards, hydrants, bus shelters, cycle racks. Local -y faces the road."""

from __future__ import annotations

import numpy as np

from mlsroad_pipeline.algorithms.classes import TAXONOMY
from mlsroad_pipeline.algorithms.simulation.materials import SIGN_BLUE, SIGN_WHITE, cloth, material, retroreflective
from mlsroad_pipeline.algorithms.simulation.meshes import (
    Mesh,
    Surface,
    box,
    ellipsoid,
    join,
    plate,
    polygon,
    quads,
    tube,
)
from mlsroad_pipeline.algorithms.simulation.vehicles import bicycle

_UNDERGROUND = 0.2


def waste_bin(rng: np.random.Generator) -> Mesh:
    """Return a litter bin, a wheeled bin or one on a post.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its design, measures and colour.

    Returns
    -------
    Mesh
        Every face is `bin`.
    """
    skin = material(str(rng.choice(["plastic", "galvanised", "painted_metal"])), "bin", rng)
    design = int(rng.integers(3))
    if design == 0:
        radius, height = rng.uniform(0.2, 0.32), rng.uniform(0.75, 1.05)
        z = np.array([-_UNDERGROUND, 0.0, 0.7 * height, height, height + 0.06])
        path = np.column_stack([0 * z, 0 * z, z])
        return tube(path, radius * np.array([0.85, 0.85, 1, 1, 0.5]), skin, sides=12)
    if design == 1:
        size = rng.uniform([0.48, 0.5, 0.9], [0.65, 0.75, 1.15])
        body = box([size[0] * 0.85, size[1] * 0.85, size[2]], [0, 0, size[2] / 2], skin, taper=1.15)
        lid = box([size[0] * 1.05, size[1] * 1.08, 0.07], [0, 0, size[2] + 0.03], skin)
        dark = material("rubber", "bin", rng)
        wheel = tube([[-0.28, 0.25, 0.1], [0.28, 0.25, 0.1]], 0.1, dark, sides=10)
        return join([body, lid, wheel])
    height = rng.uniform(0.8, 1.1)
    post = tube([[0, 0.2, -_UNDERGROUND], [0, 0.2, height + 0.15]], 0.035, skin)
    return join([post, tube([[0, 0, height - 0.55], [0, 0, height]], rng.uniform(0.15, 0.21), skin, sides=10)])


def bench(rng: np.random.Generator) -> Mesh:
    """Return a bench, with or without a back.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its measures and colours.

    Returns
    -------
    Mesh
        1.3 to 2.1 m long along x; every face is `bench`.
    """
    slat, leg = material("wood", "bench", rng), material("painted_metal", "bench", rng)
    length, height = rng.uniform(1.3, 2.1), rng.uniform(0.42, 0.5)
    meshes = [box([length, 0.1, 0.035], [0, y, height], slat) for y in np.linspace(-0.2, 0.2, int(rng.integers(3, 5)))]
    has_back = rng.random() < 0.7
    if has_back:
        meshes += [box([length, 0.03, 0.1], [0, 0.26, height + dz], slat) for dz in (0.18, 0.34)]
    for x in (-0.4 * length, 0.4 * length):
        meshes.append(box([0.07, 0.45, height + _UNDERGROUND], [x, 0, (height - _UNDERGROUND) / 2], leg))
        if has_back:
            meshes.append(tube([[x, 0.22, height], [x, 0.28, height + 0.4]], 0.02, leg, sides=5))
    return join(meshes)


def bollards(rng: np.random.Generator) -> list[Mesh]:
    """Return a row of bollards of one design, one mesh each.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of their number, measures and colour.

    Returns
    -------
    list of Mesh
        Three to five, 1.3 m apart along x; every face is `bollard`.
    """
    skin = material(str(rng.choice(["concrete", "painted_metal", "galvanised"])), "bollard", rng)
    band = retroreflective(SIGN_WHITE, "bollard", rng)
    radius, height = rng.uniform(0.05, 0.12), rng.uniform(0.65, 1.05)
    row = []
    for k in range(int(rng.integers(3, 6))):
        lean = rng.normal(0, 0.02, 2)
        post = tube([[0, 0, -_UNDERGROUND], [lean[0], lean[1], height]], radius, skin, sides=10)
        cap = ellipsoid([lean[0], lean[1], height], [radius, radius, 0.6 * radius], skin)
        ring = tube([[0, 0, 0.78 * height], [0, 0, 0.86 * height]], 1.04 * radius, band, sides=10)
        row.append(join([post, cap, ring]).moved([1.3 * (k - 1.5), 0, 0]))
    return row


def hydrant(rng: np.random.Generator) -> Mesh:
    """Return a hydrant.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its height and colour.

    Returns
    -------
    Mesh
        0.6 to 0.85 m high up to its dome; every face is `hydrant`.
    """
    skin = cloth("hydrant", rng)
    height = rng.uniform(0.6, 0.85)
    body = tube([[0, 0, -_UNDERGROUND], [0, 0, 0.1], [0, 0, 0.8 * height]], [0.16, 0.12, 0.11], skin, sides=10)
    dome = ellipsoid([0, 0, 0.82 * height], [0.13, 0.13, 0.15], skin)
    return join([body, dome, tube([[-0.2, 0, 0.6 * height], [0.2, 0, 0.6 * height]], 0.055, skin)])


def mail_box(rng: np.random.Generator) -> Mesh:
    """Return a mail box on its foot or on a post.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its measures and colour.

    Returns
    -------
    Mesh
        Every face is `mail_box`.
    """
    skin = cloth("mail_box", rng)
    size = rng.uniform([0.35, 0.3, 0.5], [0.55, 0.5, 0.9])
    low = rng.uniform(0.35, 0.8)
    foot = box([0.12, 0.12, low + _UNDERGROUND], [0, 0, (low - _UNDERGROUND) / 2], skin)
    return join([foot, box(size, [0, 0, low + size[2] / 2], skin, taper=0.95)])


def bus_shelter(rng: np.random.Generator) -> Mesh:
    """Return a bus shelter: posts, roof, glass back and side, a bench and a panel; its sign stands on its own post.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its measures and colours.

    Returns
    -------
    Mesh
        Its back is at +y, its posts 2.8 to 4.4 m apart along x; every face is `bus_shelter`.
    """
    metal, glass = material("painted_metal", "bus_shelter", rng), material("glass", "bus_shelter", rng)
    length, depth, height = rng.uniform([2.8, 1.15, 2.3], [4.4, 1.6, 2.6])
    meshes = [box([length + 0.4, depth + 0.4, 0.1], [0, 0, height], metal)]
    for x in np.linspace(-length / 2, length / 2, 3):
        meshes.append(box([0.07, 0.07, height + _UNDERGROUND], [x, depth / 2, (height - _UNDERGROUND) / 2], metal))
    for x in (-length / 2, length / 2):
        meshes.append(box([0.07, 0.07, height + _UNDERGROUND], [x, -depth / 2, (height - _UNDERGROUND) / 2], metal))
    back, low, high = depth / 2, 0.25, height - 0.25
    half = length / 2
    meshes.append(quads([[-half, back, low], [half, back, low], [half, back, high], [-half, back, high]], glass))
    poster = cloth("bus_shelter", rng)
    meshes.append(box([0.08, depth * 0.9, 1.7], [half, 0, 1.15], poster))
    meshes.append(box([0.6 * length, 0.35, 0.06], [-0.1, 0.25 * depth, 0.47], metal))
    for x in (-0.25 * length, 0.2 * length):
        meshes.append(box([0.05, 0.25, 0.47 + _UNDERGROUND], [x, 0.25 * depth, (0.45 - _UNDERGROUND) / 2], metal))
    return join(meshes)


def bus_stop_sign(rng: np.random.Generator) -> Mesh:
    """Return the post and plate of a stop.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its measures and colours.

    Returns
    -------
    Mesh
        2.5 to 3 m high, its plate seen along the road; every face is `station_sign`.
    """
    metal = material("galvanised", "station_sign", rng)
    face = retroreflective(SIGN_BLUE, "station_sign", rng)
    height = rng.uniform(2.5, 3.0)
    outline = polygon(4, rng.uniform(0.28, 0.36), start=np.pi / 4)
    sheet = plate(outline, face, face).moved([0.25, 0, height - 0.3], yaw=np.pi / 2 + rng.normal(0, 0.1))
    timetable = Surface(TAXONOMY["station_sign"], (0.6, 0.6, 0.58), float(rng.uniform(0.3, 0.6)))
    card = box([0.3, 0.03, 0.45], [0, -0.05, 1.5], timetable)
    return join([tube([[0, 0, -_UNDERGROUND], [0, 0, height]], 0.033, metal), sheet, card])


def cycle_rack(rng: np.random.Generator) -> tuple[Mesh, list[Mesh]]:
    """Return hoops, and the bicycles that lean on some of them.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the bicycles, and of which places are taken.

    Returns
    -------
    hoops : Mesh
        Two hoops along x, `other_object`.
    bicycles : list of Mesh
        None to four, at their places.
    """
    metal = material("galvanised", "other_object", rng)
    hoops, bikes = [], []
    for x in (-1.05, 1.05):
        turn = np.linspace(0, np.pi, 9)
        arch = np.column_stack([x + 0.38 * np.cos(turn), np.zeros(9), 0.45 + 0.35 * np.sin(turn)])
        feet = [[x + 0.38, 0, -_UNDERGROUND]], [[x - 0.38, 0, -_UNDERGROUND]]
        hoops.append(tube(np.concatenate([feet[0], arch, feet[1]]), 0.025, metal, sides=6))
        for side in (-1, 1):
            if rng.random() < 0.6:
                place = [x + rng.normal(0, 0.12), side * rng.uniform(0.1, 0.16), 0.0]
                turned = np.pi * int(rng.integers(2)) + rng.normal(0, 0.06)
                bikes.append(bicycle(rng).moved(place, yaw=turned, roll=rng.normal(0, 0.05)))
    return join(hoops), bikes
