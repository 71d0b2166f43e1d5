"""The mesh of a street's ground: a grid along the street, refitted to the curbs where side streets join."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from mlsroad_pipeline.algorithms.simulation.alignment import STEP
from mlsroad_pipeline.algorithms.simulation.ground import CURB_FACE, GUTTER
from mlsroad_pipeline.algorithms.simulation.junctions import (
    HALF_WIDTH,
    RADIUS,
    SIDE,
    STATION,
    arm_place,
    corner_curve,
)
from mlsroad_pipeline.algorithms.simulation.meshes import GROUND, Mesh, Surface
from mlsroad_pipeline.algorithms.simulation.street import BLOCK, HALF_DEPTH, Street

_CLEAR = 0.2  # grid points closer to a curb that is not part of the grid are left out, metres


def _across(street: Street) -> NDArray[np.float64]:
    """Return the offsets of the grid's lines, which follow curbs."""
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
    """Return the places of the curbs' feet and tops that the grid does not follow."""
    ground = street.ground
    places = []
    median = float(ground.shape[5])
    for arm in arms:
        half = float(ground.section[int(arm[SIDE]), 0])
        places += [corner_curve(arm, half, d, HALF_DEPTH, k) for d in (0.0, CURB_FACE) for k in (-1, 1)]
        # The side street's crown and gutters.
        reach = np.arange(arm[RADIUS] + 1.0, HALF_DEPTH - half, 1.0)
        lines = (0.0, arm[HALF_WIDTH] - GUTTER, GUTTER - arm[HALF_WIDTH])
        places.append(np.array([arm_place(arm, half, float(t), float(q)) for q in lines for t in reach]))
        if median > 0:
            radius, opening = 0.95 * median, arm[HALF_WIDTH] + 0.6 * arm[RADIUS]
            angle = np.linspace(0, np.pi / 2, max(int(radius * 6.5), 10))
            for d in (0.0, CURB_FACE):
                along = opening + radius - (radius - d) * np.sin(angle)
                off = median - radius + (radius - d) * np.cos(angle)
                places += [
                    np.stack([arm[STATION] + k * along, sign * off], axis=1) for k in (-1, 1) for sign in (-1, 1)
                ]
    found = np.concatenate(places)
    inside = (found[:, 0] > stations[0] + 0.1) & (found[:, 0] < stations[-1] - 0.1)
    return found[inside & (np.abs(found[:, 1]) <= HALF_DEPTH)]


def _refitted(
    street: Street, arms: NDArray[np.float64], stations: NDArray[np.float64], grid: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return places and triangles of a block with side streets."""
    ground = street.ground
    distance, arm = ground.edge(grid[:, 0], grid[:, 1])
    plain = ground._replace(arms=np.zeros((0, 9)))
    undisturbed, _ = plain.edge(grid[:, 0], grid[:, 1])
    moved = (arm >= 0) | (np.abs(distance - undisturbed) > 1e-9)
    # Points on the old curb lines inside a mouth are not needed there; those near the new lines would be in their way.
    near = np.abs(distance - CURB_FACE / 2) < _CLEAR
    keep = ~(moved & near)
    places = np.concatenate([grid[keep], _curves(street, arms, stations)])
    places = places[np.unique(np.round(places, 4), axis=0, return_index=True)[1]]
    faces = Delaunay(places).simplices.astype(np.int64)
    a, b, c = (places[faces[:, k]] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    faces = faces[np.abs(area) > 1e-7]
    turned = area[np.abs(area) > 1e-7] < 0
    faces[turned] = faces[turned][:, ::-1]
    return places, faces


def ground_mesh(street: Street, block: int) -> Mesh:
    """Return the ground of one block; what covers it is looked up where a pulse meets it.

    Parameters
    ----------
    street : Street
        The street.
    block : int
        Number of the block; block 0 begins at station 0.

    Returns
    -------
    Mesh
        A grid, finer across than along, that follows curbs; where side streets join, triangles between its points and
        points along their curbs (Delaunay).
    """
    ground = street.ground
    across = _across(street)
    stations = np.arange(block * BLOCK, (block + 1) * BLOCK + STEP / 2, STEP)
    s, left = (grid.ravel() for grid in np.meshgrid(stations, across, indexing="ij"))
    arms = ground.arms[(ground.arms[:, STATION] > stations[0]) & (ground.arms[:, STATION] < stations[-1])]
    if len(arms):
        places, faces = _refitted(street, arms, stations, np.stack([s, left], axis=1))
        s, left = places.T
    else:
        i, j = (g.ravel() for g in np.meshgrid(np.arange(len(stations) - 1), np.arange(len(across) - 1), indexing="ij"))
        a = i * len(across) + j
        b = a + len(across)
        faces = np.concatenate([np.stack([a, b, b + 1], 1), np.stack([a, b + 1, a + 1], 1)])
    xy, _ = street.alignment.place(s, left)
    vertices = np.column_stack([xy, ground.height(s, left)])
    return Mesh(vertices, faces, Surface(0, (0.2, 0.2, 0.2), 0.3, GROUND).rows(len(faces)))
