"""Plants: every function draws one individual, standing at the local origin, z up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.simulation.materials import material
from mlsroad_pipeline.algorithms.simulation.meshes import Mesh, Surface, join, leaves, tube

_UNDERGROUND = 0.25  # stems go this deep, so that nothing floats on a slope


def _direction(azimuth: float, elevation: float) -> NDArray[np.float64]:
    return np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])


def _ball(rng: np.random.Generator, n: int, *, shell: float) -> NDArray[np.float64]:
    """Draw points of the unit ball, denser towards its surface the larger `shell` is."""
    points = rng.normal(size=(n, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points * rng.random((n, 1)) ** (1 / (3 + shell))


def _branch(
    rng: np.random.Generator, start: NDArray[np.float64], direction: NDArray[np.float64], length: float, radius: float,
    bark: Surface, depth: int, tips: list[NDArray[np.float64]],
) -> list[Mesh]:  # fmt: skip
    """Grow a bent branch and its twigs; leaf places are appended to `tips`."""
    steps = np.linspace(0, 1, 5)[:, None]
    bend = rng.normal([0, 0, 0.12], 0.18)
    path = start + length * (steps * direction + steps**2 * bend)
    meshes = [tube(path, radius * np.linspace(1, 0.45, 5), bark, sides=6 if radius > 0.04 else 4)]
    if depth == 0:
        tips.extend(path[2:])
        return meshes
    for _ in range(int(rng.integers(3, 6))):
        at = rng.uniform(0.35, 1.0)
        origin = start + length * (at * direction + at**2 * bend)
        turned = direction + rng.normal(0, 0.55, 3)
        turned /= np.linalg.norm(turned)
        meshes += _branch(rng, origin, turned, length * rng.uniform(0.4, 0.65), radius * 0.5, bark, depth - 1, tips)
    return meshes


def broadleaf_tree(rng: np.random.Generator) -> Mesh:
    """Return a tree with a trunk, two orders of branches and a porous crown of leaves.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its shape and colours.

    Returns
    -------
    Mesh
        Some 5 to 15 m high; the trunk is `trunk`, branches and leaves are `tree`.
    """
    height = rng.uniform(5.0, 11.5)
    clear = rng.uniform(1.9, 0.42 * height)
    radius = 0.012 * height * rng.uniform(0.9, 1.6)
    trunk, bark = material("bark", "trunk", rng), material("bark", "tree", rng)
    lean = rng.normal(0, 0.05, 2)
    steps = np.linspace(-_UNDERGROUND, clear, 6)
    path = np.column_stack([lean[0] * steps, lean[1] * steps, steps])
    path[1:-1, :2] += rng.normal(0, 0.02, (4, 2))
    flare = radius * np.array([1.45, 1.12, 1.0, 0.95, 0.9, 0.85])
    meshes = [tube(path, flare, trunk, sides=10)]
    tips: list[NDArray[np.float64]] = []
    columnar = rng.uniform(0.25, 1.15)
    for k in range(int(rng.integers(5, 9))):
        azimuth = 2.4 * k + rng.normal(0, 0.3)
        elevation = rng.uniform(0.35, 1.0) + 0.3 * (1 - columnar)
        length = (height - clear) * rng.uniform(0.42, 0.62) * (0.6 + 0.5 * columnar)
        start = path[-1] - [0, 0, rng.uniform(0, 0.25 * clear)]
        meshes += _branch(rng, start, _direction(azimuth, elevation), length, radius * 0.5, bark, 2, tips)
    meshes += _branch(rng, path[-1], _direction(0, 1.5), 0.6 * (height - clear), radius * 0.7, bark, 2, tips)
    return join([*meshes, _crown(rng, np.array(tips), clear)])


def _crown(rng: np.random.Generator, tips: NDArray[np.float64], clear: float) -> Mesh:
    n = int(rng.uniform(4000, 9500))
    picked = tips[rng.integers(0, len(tips), n)]
    centres = picked + rng.normal(0, rng.uniform(0.14, 0.26), (n, 3))
    centres = centres[centres[:, 2] > 0.85 * clear]
    size = rng.uniform(0.11, 0.19)
    droop = rng.normal(0, 1, centres.shape) - [0, 0, rng.uniform(0, 0.8)]
    length = size * rng.uniform(0.7, 1.4, len(centres))
    return leaves(centres, droop, length, 0.62 * length, material("leaf", "tree", rng), rng)


def palm(rng: np.random.Generator) -> Mesh:
    """Return a palm: a ringed trunk, feathered fronds that arch, and dead ones that hang.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its shape and colours.

    Returns
    -------
    Mesh
        A trunk of 3 to 9 m; every face is `palm`.
    """
    height = rng.uniform(3.0, 9.0)
    radius = rng.uniform(0.12, 0.24)
    bark = material("palm_bark", "palm", rng)
    steps = np.linspace(0, 1, 24)
    curve = rng.normal(0, 0.25, 2)
    z = -_UNDERGROUND + steps * (height + _UNDERGROUND)
    path = np.column_stack([curve[0] * steps**2, curve[1] * steps**2, z])
    swelling = 1 + rng.uniform(0.1, 0.5) * np.exp(-8 * steps) + 0.05 * (np.arange(24) % 2)
    meshes = [tube(path, radius * swelling, bark, sides=10)]
    living, dead = material("leaf", "palm", rng), material("dry_leaf", "palm", rng)
    top = path[-1]
    reach = rng.uniform(1.6, 2.9)
    for k in range(int(rng.integers(18, 32))):
        elevation = rng.uniform(-0.25, 1.35)
        meshes += _frond(rng, top, 2.4 * k + rng.normal(0, 0.2), elevation, reach * rng.uniform(0.8, 1.1), living)
    for _ in range(int(rng.integers(0, 7))):
        meshes += _frond(rng, top, rng.uniform(0, 6.28), rng.uniform(-1.3, -0.8), reach * rng.uniform(0.5, 0.8), dead)
    return join(meshes)


def _frond(
    rng: np.random.Generator, top: NDArray[np.float64], azimuth: float, elevation: float, reach: float, leaf: Surface
) -> list[Mesh]:
    along = np.linspace(0, 1, 9)
    sag = rng.uniform(0.35, 0.7) * max(np.cos(elevation), 0.15)
    out = reach * along * np.cos(elevation)
    up = reach * (along * np.sin(elevation) - sag * along**2)
    rib = top + np.column_stack([np.cos(azimuth) * out, np.sin(azimuth) * out, up])
    tangent = np.gradient(rib, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    n = int(rng.integers(22, 34))
    at = np.sort(rng.uniform(0.12, 1.0, n))
    place = np.column_stack([np.interp(at, along, rib[:, k]) for k in range(3)])
    forward = np.column_stack([np.interp(at, along, tangent[:, k]) for k in range(3)])
    side = np.cross(forward, [0.0, 0.0, 1.0]) * np.where(np.arange(n) % 2, 1, -1)[:, None]
    blade = side + 0.6 * forward + [0, 0, -0.25] + rng.normal(0, 0.12, (n, 3))
    length = reach * 0.27 * np.sin(np.pi * np.clip(at, 0.1, 0.93)) * rng.uniform(0.8, 1.2, n)
    middle = place + blade / np.linalg.norm(blade, axis=1, keepdims=True) * length[:, None] / 2
    stem = Surface(leaf.label, leaf.rgb, leaf.reflectivity)
    return [tube(rib, np.linspace(0.022, 0.006, 9), stem, sides=4), leaves(middle, blade, length, 0.07, leaf, rng)]


def cycas(rng: np.random.Generator) -> Mesh:
    """Return a cycad: a short thick stem under a rosette of stiff fronds.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its shape and colours.

    Returns
    -------
    Mesh
        A stem of 0.15 to 0.8 m; every face is `cycas`.
    """
    stem = rng.uniform(0.15, 0.8)
    radius = rng.uniform(0.1, 0.2)
    bark, leaf = material("palm_bark", "cycas", rng), material("leaf", "cycas", rng)
    path = np.column_stack([np.zeros(4), np.zeros(4), np.linspace(-_UNDERGROUND, stem, 4)])
    meshes = [tube(path, radius * np.array([1.1, 1.15, 1.0, 0.6]), bark, sides=9)]
    reach = rng.uniform(0.65, 1.25)
    for k in range(int(rng.integers(20, 38))):
        elevation = rng.uniform(0.05, 1.3)
        meshes += _frond(rng, path[-1], 2.4 * k, elevation, reach * rng.uniform(0.85, 1.1), leaf)
    return join(meshes)


def brushwood(rng: np.random.Generator) -> Mesh:
    """Return a clump of shrubs: many thin stems and leaves down to the ground.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its shape and colours.

    Returns
    -------
    Mesh
        Every face is `brushwood`.
    """
    size = rng.uniform([0.5, 0.45, 0.5], [1.5, 0.95, 1.5])
    bark, leaf = material("bark", "brushwood", rng), material("leaf", "brushwood", rng)
    n = int(900 * size[0] * size[1] * size[2] ** 0.5 + 350)
    lobes = rng.uniform(-0.55, 0.55, (int(rng.integers(2, 6)), 3)) * size
    lobes[:, 2] = rng.uniform(0.25, 0.6, len(lobes)) * size[2]
    which = rng.integers(0, len(lobes), n)
    centres = lobes[which] + _ball(rng, n, shell=3) * size * [0.6, 0.7, 0.5]
    centres[:, 2] = np.abs(centres[:, 2]) + 0.02
    length = rng.uniform(0.06, 0.13) * rng.uniform(0.7, 1.4, n)
    meshes = [leaves(centres, rng.normal(size=(n, 3)), length, 0.6 * length, leaf, rng)]
    for tip in centres[:: max(n // 12, 1)]:
        root = np.array([0.25 * tip[0], 0.25 * tip[1], -_UNDERGROUND])
        meshes.append(tube([root, (root + tip) / 2 + rng.normal(0, 0.05, 3), tip], [0.015, 0.01, 0.004], bark, sides=4))
    return join(meshes)


def hedge(rng: np.random.Generator, length: float) -> Mesh:
    """Return a clipped hedge along x, centred; its faces are leaves, its inside is twigs.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its measures, leaves and colours.
    length : float
        Length along x, metres.

    Returns
    -------
    Mesh
        0.7 to 1.9 m high; every face is `hedge`.
    """
    height, depth = rng.uniform(0.7, 1.9), rng.uniform(0.4, 0.8)
    leaf, bark = material("leaf", "hedge", rng), material("bark", "hedge", rng)
    area = 2 * length * height + length * depth
    n = int(330 * area)
    place = rng.uniform(-1, 1, (n, 3))
    # Leaves crowd near the two faces and the top.
    pick = rng.random(n)
    place[:, 1] = np.where(pick < 0.75, np.sign(place[:, 1]) * (1 - 0.25 * rng.random(n) ** 2), place[:, 1])
    place[:, 2] = np.where(pick > 0.72, 1 - 0.2 * rng.random(n) ** 2, place[:, 2])
    centres = place * [length / 2, depth / 2, height / 2] + [0, 0, height / 2]
    centres[:, 2] += 0.04 * np.sin(centres[:, 0] * 2.1) * (centres[:, 2] / height)
    size = rng.uniform(0.06, 0.11) * rng.uniform(0.7, 1.3, n)
    meshes = [leaves(centres, rng.normal(size=(n, 3)), size, 0.65 * size, leaf, rng)]
    for x in np.arange(-length / 2 + 0.2, length / 2, 0.45):
        top = [x + rng.normal(0, 0.08), rng.normal(0, 0.08), 0.8 * height]
        meshes.append(tube([[x, 0, -_UNDERGROUND], top], [0.02, 0.008], bark, sides=4))
    return join(meshes)
