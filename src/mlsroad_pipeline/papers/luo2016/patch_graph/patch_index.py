"""Search index of patches, sorted by scene, grid cell and height."""

from __future__ import annotations

from math import ceil
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.cell_grid import build_cell_grids
from mlsroad_pipeline.papers.luo2016.patch_graph.costs import CostWeights, weigh_descriptors
from mlsroad_pipeline.papers.shared.patches.table import Patches

_CELLS_PER_RADIUS = 4


class PatchIndex(NamedTuple):
    """Patches sorted by scene and, within a scene, by grid cell with x fastest.

    A ball around a patch covers a few rows of cells, and each row is a contiguous range of patches.
    """

    table: NDArray[np.float32]  # Weighted descriptors, see `weigh_descriptors`
    xyz: NDArray[np.float32]  # Centroids relative to the minimum corner of their scene, metres
    scene: NDArray[np.int32]  # Scene of each patch, 0 to s - 1
    scene_starts: NDArray[np.int64]  # Start of each scene
    cell: NDArray[np.int32]  # Cell of each patch
    # Range of patches (first, one past the last) of each row of cells within the propagation radius of a cell, and
    # within the radius of the local search
    near: NDArray[np.int32]
    # Range of patches (first, one past the last) of each row of cells within the propagation radius of a cell, and
    # within the radius of the local search
    far: NDArray[np.int32]
    by_height: NDArray[np.int32]  # Patches sorted by height within each scene
    heights: NDArray[np.float32]  # Their heights, metres


@njit(cache=True, nogil=True)
def _row_limits(keys: NDArray, starts: NDArray, rows: NDArray, reach: int, first: int, out: NDArray) -> None:
    """Write the ranges of patches in the rows around each cell of a scene; keys are ascending."""
    for j in range(len(rows)):
        begin, end = 0, 0
        for cell in range(len(keys)):
            low = keys[cell] + rows[j, 2] - reach
            while begin < len(keys) and keys[begin] < low:
                begin += 1
            end = max(end, begin)
            while end < len(keys) and keys[end] <= low + 2 * reach:
                end += 1
            out[cell, j, 0] = first + starts[begin]
            out[cell, j, 1] = first + starts[end]


def build_patch_index(
    patches: Patches, weights: CostWeights, *, near_radius: float, far_radius: float, with_colour: bool
) -> tuple[PatchIndex, NDArray[np.int64], NDArray[np.int32]]:
    """Sort patches for matching."""
    # Cells are slightly wider than the radius: float32 rounding cannot put a neighbour outside the rows.
    size = max(near_radius, far_radius / _CELLS_PER_RADIUS) * (1 + 1e-5)
    reaches = ceil(near_radius / size), ceil(far_radius / size)
    scenes, scene_of = np.unique(patches.scene, return_inverse=True)
    by_scene = np.argsort(scene_of, kind="stable")
    scene_starts = np.concatenate([[0], np.cumsum(np.bincount(scene_of))]).astype(np.int64)
    order = np.empty(len(patches), np.int64)
    xyz = np.empty((len(patches), 3), np.float32)
    cell = np.empty(len(patches), np.int32)
    limits: tuple[list[NDArray], list[NDArray]] = ([], [])
    n_cells = 0
    for first, last in zip(scene_starts[:-1].tolist(), scene_starts[1:].tolist(), strict=True):
        members = by_scene[first:last]
        centroids = patches.centroid[members]
        grid = build_cell_grids(centroids, cell_size=size, margin=max(reaches))[0]
        order[first:last] = members[grid.order]
        xyz[first:last] = (centroids - grid.minimum)[grid.order]
        cell[first:last] = n_cells + np.repeat(np.arange(len(grid.keys)), np.diff(grid.starts))
        for reach, ranges in zip(reaches, limits, strict=True):
            rows = grid.row_offsets(reach)
            ranges.append(np.empty((len(grid.keys), len(rows), 2), np.int32))
            _row_limits(grid.keys, grid.starts, rows, reach, first, ranges[-1])
        n_cells += len(grid.keys)
    table = weigh_descriptors(patches, weights, with_colour=with_colour)[order]
    height, scene = patches.height[order], scene_of[order].astype(np.int32)
    by_height = np.lexsort((height, scene)).astype(np.int32)
    near, far = (np.concatenate(ranges) for ranges in limits)
    index = PatchIndex(table, xyz, scene, scene_starts, cell, near, far, by_height, height[by_height])
    return index, order, scenes.astype(np.int32)
