"""Slow, obvious re-implementations of the voxel and supervoxel kernels."""

import itertools
import math

import numpy as np

OFFSETS = [o for o in itertools.product((-1, 0, 1), repeat=3) if o != (0, 0, 0)]
QUANTUM = 2.0**-20


def voxelise(xyz, size):
    """Return {coordinates relative to the bounding box's centre: point numbers}."""
    xyz = np.asarray(xyz, dtype=np.float64)
    centre = (xyz.min(0) + xyz.max(0)) / 2
    voxels = {}
    for i, p in enumerate(xyz):
        voxels.setdefault(tuple(math.floor(t) for t in (p - centre) / size), []).append(i)
    return voxels, centre


def neighbours(voxels):
    """Return {voxel: occupied voxels among its 26}."""
    return {c: [n for n in (tuple(np.add(c, o)) for o in OFFSETS) if n in voxels] for c in voxels}


def brick_order(c):
    """Sort key of a voxel: x, y, z of its brick of 8 x 8 x 8, then x, y, z inside, the grid starting on a brick."""
    return tuple(t // 8 for t in c) + tuple(t % 8 for t in c)


def morton(c):
    """Return the place of a voxel on the octree's depth-first walk."""
    key = 0
    for bit in range(24, -1, -1):
        for t in c:
            key = key * 2 + (((t + (1 << 24)) >> bit) & 1)
    return key


def normal(c, centroid, near):
    """Fit a plane to everything that a walk of at most two steps reaches, as often as it does."""
    # moments of the voxel, its sum over the closed neighbourhood, and the sums of those of its neighbours
    walks = [c] + ([c] + near[c])
    for n in near[c]:
        walks += [n] + near[n]
    points = np.array([centroid[w] for w in walks])
    values, vectors = np.linalg.eigh(np.cov(points.T, bias=True) if len(points) > 1 else np.zeros((3, 3)))
    if values.sum() <= 0:
        return np.zeros(3)
    scaled = values / values.sum()
    if (scaled[1] - scaled[0]) * (scaled[2] - scaled[0]) * np.abs(vectors[:, 0]).max() <= 1e-6:
        return np.zeros(3)
    return vectors[:, 0]


def vccs(xyz, size, seed_resolution, weights=(0.4, 1.0, 0.2), rgb=None, divisor=3.0):
    """Return the partition as a set of frozensets of points, step by step as the method page tells it."""
    cells, centre = voxelise(xyz, size)
    xyz = np.asarray(xyz, dtype=np.float64)
    low = min(c[0] for c in cells), min(c[1] for c in cells), min(c[2] for c in cells)
    order = sorted(cells, key=lambda c: brick_order(tuple(np.subtract(c, low))))
    near = neighbours(cells)
    origin = centre + np.array(low) * size
    centroid, colour = {}, {}
    for c in order:
        steps = np.floor((xyz[cells[c]] - origin) / size / QUANTUM) * QUANTUM
        centroid[c] = steps.mean(axis=0)
        colour[c] = np.zeros(3) if rgb is None else rgb[cells[c]].mean(axis=0) / 255
    normals = {c: normal(c, centroid, near) for c in order}
    radius = seed_resolution / size
    w_s, w_n, w_c = weights[0] / (divisor * radius**2), weights[1], weights[2] if rgb is not None else 0.0

    def distance(model, c):
        turned = 1 - abs(model[1] @ normals[c])
        return w_s * ((model[0] - centroid[c]) ** 2).sum() + w_n * turned**2 + w_c * ((model[2] - colour[c]) ** 2).sum()

    def level(owner, models):
        new = dict(owner)
        for c in order:
            own = owner.get(c)
            claims = sorted({(distance(models[owner[n]], c), owner[n]) for n in near[c] if n in owner})
            claims = [claim for claim in claims if claim[1] != own]
            if claims and (own is None or claims[0][0] < distance(models[own], c)):
                new[c] = claims[0][1]
        return new

    def models_of(owner, old):
        models = dict(old)
        for s in set(owner.values()):
            mine = [c for c in order if owner.get(c) == s]
            total = sum(normals[c] * (-1 if old[s][1] @ normals[c] < 0 else 1) for c in mine)
            length = np.linalg.norm(total)
            models[s] = (
                np.mean([centroid[c] for c in mine], axis=0),
                total / length if length > 0 else total,
                np.mean([colour[c] for c in mine], axis=0),
            )
        return models

    def start(seeds):
        return {c: s for s, c in enumerate(seeds)}, {
            s: (centroid[c], normals[c], colour[c]) for s, c in enumerate(seeds)
        }

    seeds = spread(order, near, centroid, radius, anchor=centroid[min(order, key=morton)])
    owner = level(*start(seeds))
    seeds = without_slivers(seeds, near, owner, radius)
    owner, models = start(seeds)
    for _ in range(int(1.8 * radius + 1e-9) - 1):
        owner = level(owner, models)
        models = models_of(owner, models)
    return complete(order, near, cells, owner, models, distance)


def spread(order, near, centroid, radius, anchor):
    """Choose the voxel nearest to each cell's centre; drop those without company, and those beside an earlier one."""
    best = {}
    for c in order:
        place = (centroid[c] - anchor) / radius
        cell = tuple(np.floor(place))
        d = ((place - np.floor(place) - 0.5) ** 2).sum()
        if cell not in best or d < best[cell][0]:
            best[cell] = (d, c)
    chosen = {c for _, c in best.values()}
    needed = int(0.05 * math.pi * (radius / 2) ** 2) + 1
    seeds = []
    for c in order:
        if c in chosen and not any(n in seeds for n in near[c]):
            company = [c]
            for m in company:
                company += [
                    n for n in near[m] if n not in company and np.linalg.norm(centroid[n] - centroid[c]) <= radius / 2
                ]
            if len(company) >= needed:
                seeds.append(c)
    return seeds


def without_slivers(seeds, near, owner, radius):
    """Drop seeds whose few voxels all touch those of an earlier living one."""
    dead = set()
    for s, c in enumerate(seeds):
        mine = [v for v in [c] + near[c] if owner[v] == s]
        touched = [any(owner.get(n, s) < s and owner[n] not in dead for n in near[v]) for v in mine]
        if all(touched) and len(mine) <= radius**3 / 4 + 1e-9:
            dead.add(s)
    return [c for s, c in enumerate(seeds) if s not in dead]


def pieces(members, near):
    """Return the connected components of a list of voxels, in the list's order."""
    left, found = list(members), []
    while left:
        piece = [left[0]]
        for c in piece:
            piece += [n for n in near[c] if n in left and n not in piece]
        found.append(piece)
        left = [c for c in left if c not in piece]
    return found


def complete(order, near, cells, owner, models, distance):
    """Keep the largest piece of each supervoxel, flood the rest, make islands; return sets of points."""
    models = dict(models)
    for s in set(owner.values()):
        found = pieces([c for c in order if owner.get(c) == s], near)
        keep = max(found, key=len)
        for piece in found:
            if piece is not keep:
                for c in piece:
                    del owner[c]
    while True:
        claims = {}
        for c in order:
            if c not in owner:
                near_owners = {owner[n] for n in near[c] if n in owner}
                if near_owners:
                    claims[c] = min((distance(models[s], c), s) for s in near_owners)[1]
        if not claims:
            break
        owner.update(claims)
    for i, piece in enumerate(pieces([c for c in order if c not in owner], near)):
        owner.update(dict.fromkeys(piece, ("island", i)))
    groups = {}
    for c, s in owner.items():
        groups.setdefault(s, []).extend(cells[c])
    return {frozenset(points) for points in groups.values()}
