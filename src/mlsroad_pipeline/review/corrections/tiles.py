"""Tiles of a labelled cloud that corrections are about, with the features of their voxels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.features.voxel_scales import VoxelFeatures
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import describe_scene
from mlsroad_pipeline.algorithms.stages import find_ground

TILE, MARGIN = 30.0, 15.0
"""Edge of the tiles that are learned from, and width of the surroundings that are read with them, metres."""

_NOISE = 7


@dataclass(frozen=True)
class Tile:
    """A tile with its surroundings."""

    cell: tuple[int, int]  # Column and row in the grid of the cloud
    rows: NDArray[np.int64]  # Points of the cloud; noise is left out
    core: NDArray[np.bool_]  # Points in the tile itself
    ground: NDArray[np.bool_]  # Points of the ground
    height: NDArray[np.float32]  # Heights above the ground, metres
    voxels: VoxelFeatures  # Features of the voxels, and the voxel of each point
    scene: PointCloud  # The points with their intensity and colour


class TileGrid:
    """Square tiles of a cloud, from its lower left corner."""

    def __init__(self, cloud: PointCloud) -> None:
        self._cloud = cloud
        self._xy = cloud.xyz[:, :2]
        self._corner = self._xy.min(axis=0) if len(self._xy) else np.zeros(2)
        self.cell = np.floor((self._xy - self._corner) / TILE).astype(np.int64)

    def cell_of(self, xy: ArrayLike) -> NDArray[np.int64]:
        """Return the cells of places in world coordinates, shape (n, 2)."""
        local = np.asarray(xy, np.float64).reshape(-1, 2) - self._cloud.origin[:2]
        return np.floor((local - self._corner) / TILE).astype(np.int64)

    def described(self, cells: NDArray[np.int64], *, ground: GroundParameters, voxel_size: float) -> Iterator[Tile]:
        """Yield the tiles of cells, each once; tiles without points are left out."""
        cloud, xy = self._cloud, self._xy
        usable = np.ones(len(cloud), np.bool_) if "classification" not in cloud else cloud["classification"] != _NOISE
        for place in np.unique(cells, axis=0):
            low = self._corner + place * TILE
            near = (xy >= low - MARGIN).all(axis=1) & (xy < low + TILE + MARGIN).all(axis=1)
            rows = np.flatnonzero(usable & near)
            core = (self.cell[rows] == place).all(axis=1)
            if core.any():
                yield _described((int(place[0]), int(place[1])), cloud.select(rows), rows, core, ground, voxel_size)


def _described(
    cell: tuple[int, int],
    part: PointCloud,
    rows: NDArray[np.int64],
    core: NDArray[np.bool_],
    parameters: GroundParameters,
    voxel_size: float,
) -> Tile:
    plain = part.without_columns(set(part.columns) - {"intensity", "rgb"})
    ground = find_ground(plain, parameters)
    found = describe_scene(plain, ground, voxel_size=voxel_size)
    return Tile(cell, rows, core, ground["ground"], ground["height"], found, plain)
