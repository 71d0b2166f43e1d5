"""Mesh of a street's ground: a grid along the street, refitted to the curbs at side streets."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from mlsroad_pipeline.simulation.model.meshes import GROUND, Mesh, Surface
from mlsroad_pipeline.simulation.street.alignment import STEP
from mlsroad_pipeline.simulation.street.ground import (
    CURB_FACE,
    GUTTER,
    HALF_WIDTH,
    RADIUS,
    SIDE,
    STATION,
    arm_places,
    corner_curve,
)
from mlsroad_pipeline.simulation.street.street import BLOCK, HALF_DEPTH, Street

_CLEAR = 0.2  # grid points closer to a curb off the grid are dropped, metres


def _across(street: Street) -> NDArray[np.float64]:
    """Return the offsets of the grid lines, some of which follow curbs."""
    ground = street.ground
    median = float(ground.shape[5])
    offsets: list[float] = [0.0]
    for side, sign in ((0, 1.0), (1, -1.0)):
        half, _, curb, verge, pavement = ground.section[side]
        line = half + curb + verge + pavement
        inner = [*np.linspace(median, half - GUTTER, 8), half, half + CURB_FACE, half + curb, half + curb + verge]
        inner += [line - 0.5, line, line + 0.5, line + 1.0]
        inner += [half + curb + d for d in (0.1, 1.0, 2.0) if curb + d < line - half - 0.6]
        if median > 0:
            inner += [*np.linspace(0, median - 0.4, 5)[1:], median - CURB_FACE]
        outer = [*np.linspace(line + 2.0, line + 20.0, 19), *np.linspace(line + 23.0, HALF_DEPTH, 10)]
        offsets += [sign * float(a) for a in inner + outer]
    return np.unique(np.round(offsets, 9))


def _curves(street: Street, arms: NDArray[np.float64], stations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return places on the feet and tops of curbs between the grid lines."""
    ground = street.ground
    places = []
    median = float(ground.shape[5])
    for arm in arms:
        half = float(ground.section[int(arm[SIDE]), 0])
        places += [corner_curve(arm, half, d, HALF_DEPTH, k) for d in (0.0, CURB_FACE) for k in (-1, 1)]
        # The side street's crown and gutters.
        reach = np.arange(arm[RADIUS] + 1.0, HALF_DEPTH - half, 1.0)
        lines = (0.0, arm[HALF_WIDTH] - GUTTER, GUTTER - arm[HALF_WIDTH])
        places += [arm_places(arm, half, reach, q) for q in lines]
        if median > 0:
            radius, opening = 0.95 * median, arm[HALF_WIDTH] + 0.6 * arm[RADIUS]
            angle = np.linspace(0, np.pi / 2, max(int(radius * 6.5), 10))
            beside = np.arange(1, 5) * 0.25
            for d in (0.0, CURB_FACE):
                along = np.append(opening + radius - (radius - d) * np.sin(angle), opening + radius + beside)
                off = np.append(median - radius + (radius - d) * np.cos(angle), np.full(4, median - d))
                places += [
                    np.stack([arm[STATION] + k * along, sign * off], axis=1) for k in (-1, 1) for sign in (-1, 1)
                ]
    points = np.concatenate(places)
    inside = (points[:, 0] > stations[0] + 0.1) & (points[:, 0] < stations[-1] - 0.1)
    return points[inside & (np.abs(points[:, 1]) <= HALF_DEPTH)]


def _refitted(
    street: Street, grid: NDArray[np.float64], curves: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return places and triangles of a stretch of grid where the curbs are curved."""
    ground = street.ground
    distance, arm = ground.edge(grid[:, 0], grid[:, 1])
    undisturbed, _ = ground._replace(arms=np.zeros((0, 9))).edge(grid[:, 0], grid[:, 1])
    moved = (arm >= 0) | (np.abs(distance - undisturbed) > 1e-9)
    # Grid points close to a curved curb would distort it.
    keep = ~(moved & (np.abs(distance - CURB_FACE / 2) < _CLEAR))
    places = np.concatenate([grid[keep], curves])
    places = places[np.unique(np.round(places, 4), axis=0, return_index=True)[1]]
    faces = Delaunay(places).simplices.astype(np.int64)
    a, b, c = (places[faces[:, k]] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    faces[area < 0] = faces[area < 0][:, ::-1]
    return places, faces[np.abs(area) > 1e-7]


def _lattice(
    stations: NDArray[np.float64], across: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return places and triangles of a grid."""
    s, left = (grid.ravel() for grid in np.meshgrid(stations, across, indexing="ij"))
    i, j = (g.ravel() for g in np.meshgrid(np.arange(len(stations) - 1), np.arange(len(across) - 1), indexing="ij"))
    a = i * len(across) + j
    b = a + len(across)
    faces = np.concatenate([np.stack([a, b, b + 1], 1), np.stack([a, b + 1, a + 1], 1)])
    return np.stack([s, left], axis=1), faces


def ground_mesh(street: Street, block: int) -> Mesh:
    """Return the ground of one block: a grid, finer across than along, that follows curbs.

    At side streets it is a Delaunay triangulation of grid points and points along their curbs.
    """
    ground = street.ground
    across = _across(street)
    stations = np.arange(block * BLOCK, (block + 1) * BLOCK + STEP / 2, STEP)
    arms = ground.arms[(ground.arms[:, STATION] > stations[0]) & (ground.arms[:, STATION] < stations[-1])]
    pieces = []
    if len(arms):
        curves = _curves(street, arms, stations)
        first, last = np.searchsorted(stations, [curves[:, 0].min() - 0.6, curves[:, 0].max() + 0.6])
        first, last = max(first - 1, 0), min(last, len(stations) - 1)
        pieces.append(_refitted(street, _lattice(stations[first : last + 1], across)[0], curves))
        pieces += [_lattice(part, across) for part in (stations[: first + 1], stations[last:]) if len(part) > 1]
    else:
        pieces.append(_lattice(stations, across))
    places = np.concatenate([p for p, _ in pieces])
    before = np.cumsum([0, *(len(p) for p, _ in pieces[:-1])])
    faces = np.concatenate([f + k for (_, f), k in zip(pieces, before, strict=True)])
    xy, _ = street.alignment.place(places[:, 0], places[:, 1])
    vertices = np.column_stack([xy, ground.height(places[:, 0], places[:, 1])])
    return Mesh(vertices, faces, Surface(0, (0.2, 0.2, 0.2), 0.3, GROUND).rows(len(faces)))
