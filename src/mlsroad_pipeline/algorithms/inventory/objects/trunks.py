"""Trunks among the voxels of trees, and separation of touching trees by their trunks.

A trunk is a narrow column with points at most heights between 0.3 and 2.1 m above the ground. Low branches and bushes
reach few of these heights in any one place.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from mlsroad_pipeline.algorithms.geometry.graphs import connected_components
from mlsroad_pipeline.algorithms.inventory.objects.boxes import trimmed
from mlsroad_pipeline.algorithms.inventory.objects.voxel_sums import Voxels


def split_at_valleys(voxels: Voxels, *, spacing: float, depth: float, cell: float = 0.5) -> NDArray[np.int32]:
    """Split a group of touching trees into single trees.

    Watershed segmentation of the canopy height model, from the tops down. Two tops whose basins meet are merged if the
    valley is less than `depth` below the lower top or the tops are nearer than `spacing`.
    """
    ij = np.floor(voxels.xyz[:, :2] / cell).astype(np.int64)
    ij -= ij.min(axis=0) - 1
    shape = ij.max(axis=0) + 2
    canopy = np.full(tuple(shape), -np.inf)
    np.maximum.at(canopy, (ij[:, 0], ij[:, 1]), voxels.z_high)
    order = np.argsort(-canopy, axis=None, kind="stable")[: int(np.isfinite(canopy).sum())]
    part = _flood(canopy.ravel(), order, int(shape[1]), spacing / cell, depth)
    _, label = np.unique(part[order], return_index=True)
    number = {int(part[order[first]]): rank for rank, first in enumerate(np.sort(label))}
    cells = part[ij[:, 0] * shape[1] + ij[:, 1]]
    return np.array([number[int(c)] for c in cells], dtype=np.int32)


@njit(cache=True)
def _flood(
    height: NDArray[np.float64], order: NDArray[np.int64], stride: int, spacing: float, depth: float
) -> NDArray[np.int64]:
    """Return the cell of the top for each cell of the canopy, -1 outside; `order` is from the highest cell down."""
    top = np.full(len(height), -1, np.int64)  # top of each cell before merging
    joined = np.arange(len(height))  # higher top that a top is merged into
    for cell in order:
        best = -1
        for di in range(-1, 2):
            for dj in range(-1, 2):
                other = top[cell + di * stride + dj]
                if other < 0:
                    continue
                while joined[other] != other:
                    other = joined[other]
                if best < 0:
                    best = other
                elif other != best:
                    high, low = (best, other) if height[best] >= height[other] else (other, best)
                    apart = np.hypot(high // stride - low // stride, high % stride - low % stride)
                    if height[low] - height[cell] < depth or apart < spacing:
                        joined[low] = high
                    best = high
        top[cell] = best if best >= 0 else cell
    for cell in order:
        while joined[top[cell]] != top[cell]:
            top[cell] = joined[top[cell]]
    return top


_LOW, _HIGH, _LAYER = 0.3, 2.1, 0.3  # heights of a trunk above the ground and of the layers that are counted, metres
_CELL = 0.2  # edge of the columns in plan, metres
_WIDEST = 1.2  # largest extent of a trunk along x or y, metres
_FOOT = 0.8  # height of the part of a trunk that gives its position, metres
_STRAY = 0.02  # share of voxels trimmed on each side for the position of the foot
_ONE_TREE = 0.9  # trunks closer than this belong to one tree, metres
_CROWN = 3.5  # largest distance of the middle of a part without a trunk from the trunk that it belongs to, metres
FEWEST_LAYERS = 4
"""Fewest of six layers that have points in a trunk."""


class Trunk(NamedTuple):
    """Trunk of a tree."""

    x: float  # m, position of its foot
    y: float
    width: float  # m, largest extent along x or y
    layers: int  # of 0.3 m with points, of 6
    low: float  # m, height of its lowest voxel above the ground
    voxels: NDArray[np.int64]


def find_trunks(voxels: Voxels, *, fewest_layers: int = FEWEST_LAYERS) -> list[Trunk]:
    """Find the trunks among the voxels of trees, by place.

    Where the ground is unknown, heights are above the lowest voxel. `fewest_layers` of 6 have points within one column
    of the neighbouring ones.
    """
    ground = np.where(np.isnan(voxels.ground), voxels.xyz[:, 2].min(), voxels.ground)
    height = voxels.xyz[:, 2] - ground
    rows = np.flatnonzero((height >= _LOW) & (height < _HIGH))
    if not len(rows):
        return []
    layer = ((height[rows] - _LOW) / _LAYER).astype(np.int64)
    column = np.floor(voxels.xyz[rows, :2] / _CELL).astype(np.int64)
    column -= column.min(axis=0)
    filled = np.zeros((*(column.max(axis=0) + 1), round((_HIGH - _LOW) / _LAYER)), dtype=bool)
    filled[column[:, 0], column[:, 1], np.minimum(layer, filled.shape[2] - 1)] = True
    near = ndimage.maximum_filter(filled, size=(3, 3, 1), mode="constant")
    upright = filled.any(axis=2) & (near.sum(axis=2) >= fewest_layers)
    region = ndimage.label(upright, np.ones((3, 3)))[0][column[:, 0], column[:, 1]]
    order = np.argsort(region, kind="stable")
    trunks = []
    for part in np.split(order, np.flatnonzero(np.diff(region[order])) + 1):
        xy, tall = voxels.xyz[rows[part], :2], height[rows[part]]
        width, layers = float(np.ptp(xy, axis=0).max()), len(np.unique(layer[part]))
        if region[part[0]] and layers >= fewest_layers - 1 and width <= _WIDEST:
            foot = xy[tall <= tall.min() + _FOOT]
            x, y = (sum(trimmed(foot[:, axis], _STRAY)) / 2 for axis in range(2))  # one side has more points
            trunks.append(Trunk(float(x), float(y), width, layers, float(tall.min()), rows[part]))
    return trunks


def main_trunk(trunks: list[Trunk]) -> Trunk | None:
    """Return the most complete trunk of a tree; None without trunks."""
    return max(trunks, key=lambda trunk: (trunk.layers, len(trunk.voxels)), default=None)


def split_trees(voxels: Voxels, *, spacing: float, depth: float) -> NDArray[np.int64]:
    """Split the voxels of a group of touching trees; return the tree of each.

    The parts of `split_at_valleys` are split where they have several trunks: each voxel belongs to the nearest trunk in
    plan. Parts without a trunk join the nearest trunk if their middle is at most 3.5 m away.
    """
    part = split_at_valleys(voxels, spacing=spacing, depth=depth).astype(np.int64)
    trunks = find_trunks(voxels, fewest_layers=FEWEST_LAYERS + 1)
    if not trunks:
        return part
    place = np.array([(trunk.x, trunk.y) for trunk in trunks])
    close = np.argwhere(np.triu(np.hypot(*(place[:, None] - place).transpose(2, 0, 1)) < _ONE_TREE, 1))
    tree = connected_components(close, n_nodes=len(trunks))
    n_trees = int(tree.max()) + 1
    place = np.stack([np.bincount(tree, place[:, axis]) / np.bincount(tree) for axis in range(2)], axis=1)
    n_parts = int(part.max()) + 1
    votes = np.zeros((n_trees, n_parts), dtype=np.int64)
    for number, trunk in zip(tree, trunks, strict=True):
        votes[number] += np.bincount(part[trunk.voxels], minlength=n_parts)
    home = votes.argmax(axis=1)
    out = np.empty(len(part), dtype=np.int64)
    for number in range(n_parts):
        rows = np.flatnonzero(part == number)
        xy = voxels.xyz[rows, :2]
        own = np.flatnonzero(home == number)
        if len(own):
            away = np.hypot(*(xy[:, None] - place[own]).transpose(2, 0, 1))
            out[rows] = own[away.argmin(axis=1)]
            continue
        away = np.hypot(*((xy.max(axis=0) + xy.min(axis=0)) / 2 - place).T)
        out[rows] = away.argmin() if away.min() < _CROWN else n_trees + number
    return np.unique(out, return_inverse=True)[1]
