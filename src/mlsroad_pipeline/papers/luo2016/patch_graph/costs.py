"""Costs of matches (Luo et al. 2016, equations 2 to 5), and index of patches by scene, grid cell and height."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.algorithms.geometry.cells import build_cell_grids
from mlsroad_pipeline.papers.shared.patches.table import Patches

N_ABSOLUTE = 4
"""Columns compared by absolute differences: red, green, blue and height."""

_LEAST = np.float32(1e-30)
_LEAST_OF_TWO = np.float32(1e-15)


@dataclass(frozen=True)
class CostWeights:
    """Weights of the three costs of a match. Without colour, its weight is distributed over the other two."""

    # Weight alpha_c of the summed absolute differences of red, green and blue in [0, 1] (equation 3)
    colour: float = 0.3
    height: float = 0.3  # Weight alpha_h of the difference of heights (equation 5)
    # Weight alpha_f of the chi-square distance of the histograms (equation 4); bins empty in both contribute 0
    shape: float = 0.4
    # H_max, the height difference of cost 1, metres. Smaller values increase the influence of height.
    max_height: float = 20.0

    def __post_init__(self) -> None:
        for name in ("colour", "height", "shape"):
            if not np.isfinite(getattr(self, name)) or getattr(self, name) < 0:
                raise ParameterError(f"the weight of {name} must be a finite number >= 0, got {getattr(self, name)!r}")
        if self.height + self.shape == 0:
            raise ParameterError("the weights of height and shape must not both be 0")
        check_positive(self.max_height, "max_height")

    def without_colour(self) -> CostWeights:
        """Return the weights for patches without colour: its weight is distributed proportionally."""
        grown = (self.colour + self.height + self.shape) / (self.height + self.shape)
        return CostWeights(0.0, self.height * grown, self.shape * grown, self.max_height)


def weigh_descriptors(patches: Patches, weights: CostWeights, *, with_colour: bool) -> NDArray[np.float32]:
    """Scale descriptors so that a cost is a sum: absolute differences of four columns, chi-square of the rest."""
    if with_colour and patches.rgb is None:
        raise DataError("the patches have no colour, but the patches to match have it")
    used = weights if with_colour else weights.without_colour()
    table = np.zeros((len(patches), N_ABSOLUTE + patches.fpfh.shape[1]), np.float32)
    if with_colour and patches.rgb is not None:
        table[:, :3] = used.colour * patches.rgb
    table[:, 3] = used.height / used.max_height * patches.height
    # The chi-square distance is linear in a common factor of both histograms.
    table[:, N_ABSOLUTE:] = used.shape * patches.fpfh
    return table


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "arcp"})
def bounded_cost(a: NDArray[np.float32], i: int, b: NDArray[np.float32], j: int, bound: np.float32) -> np.float32:
    """Return the cost of matching row i of `a` with row j of `b`, or a partial cost of at least `bound`."""
    absolute = abs(a[i, 0] - b[j, 0]) + abs(a[i, 1] - b[j, 1]) + abs(a[i, 2] - b[j, 2]) + abs(a[i, 3] - b[j, 3])
    if absolute >= bound:
        return absolute
    chi_square = np.float32(0.0)
    for k in range(N_ABSOLUTE, a.shape[1]):
        difference = a[i, k] - b[j, k]
        chi_square += difference * difference / (a[i, k] + b[j, k] + _LEAST)
    return absolute + chi_square


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "arcp"})
def block_costs(a: NDArray[np.float32], i: int, block: NDArray[np.float32], n: int, costs: NDArray[np.float32]) -> None:
    """Write the costs of matching row i of `a` with the first n columns of a transposed table.

    Loops along the columns vectorise: a tenth of the time of `bounded_cost`, with differences in the last bits. Two
    bins share a division.
    """
    for j in range(n):
        absolute = abs(a[i, 0] - block[0, j]) + abs(a[i, 1] - block[1, j])
        costs[j] = absolute + abs(a[i, 2] - block[2, j]) + abs(a[i, 3] - block[3, j])
    width = a.shape[1]
    for k in range(N_ABSOLUTE, width - 1, 2):
        p, q, first, second = a[i, k], a[i, k + 1], block[k], block[k + 1]
        for j in range(n):
            d, e = p - first[j], q - second[j]
            s, t = p + first[j] + _LEAST_OF_TWO, q + second[j] + _LEAST_OF_TWO
            costs[j] += (d * d * t + e * e * s) / (s * t)
    if (width - N_ABSOLUTE) % 2:
        p, first = a[i, width - 1], block[width - 1]
        for j in range(n):
            costs[j] += (p - first[j]) * (p - first[j]) / (p + first[j] + _LEAST)


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
    # near, far: range of patches (first, one past the last) of each row of cells within the propagation radius of a
    # cell, and within the radius of the local search
    near: NDArray[np.int32]
    far: NDArray[np.int32]
    by_height: NDArray[np.int32]  # Patches sorted by height within each scene
    heights: NDArray[np.float32]  # Their heights, metres


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
            low = grid.keys[:, None] + rows[:, 2] - reach
            ends = np.searchsorted(grid.keys, low), np.searchsorted(grid.keys, low + 2 * reach, side="right")
            ranges.append((first + grid.starts[np.stack(ends, axis=2)]).astype(np.int32))
        n_cells += len(grid.keys)
    table = weigh_descriptors(patches, weights, with_colour=with_colour)[order]
    height, scene = patches.height[order], scene_of[order].astype(np.int32)
    by_height = np.lexsort((height, scene)).astype(np.int32)
    near, far = (np.concatenate(ranges) for ranges in limits)
    index = PatchIndex(table, xyz, scene, scene_starts, cell, near, far, by_height, height[by_height])
    return index, order, scenes.astype(np.int32)
