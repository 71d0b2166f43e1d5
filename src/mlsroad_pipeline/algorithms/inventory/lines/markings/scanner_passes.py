"""Scanner and pass of each point: intensity depends on both."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.geometry.sorting import rank_integers
from mlsroad_pipeline.algorithms.inventory.objects.sightings import ROUTE, SCANNER, SECOND, SOURCE, time_passes

FILE = "file"
"""Column of a scene: number of the file."""

_CELL = 0.5  # metres
_SHARED = 0.1  # share of the cells from which two sources see the same place


def scanner_pass_of(scene: PointCloud) -> NDArray[np.int64]:
    """Return a number for the scanner and pass of each point of a scene."""
    visit = time_passes(scene[SECOND]) if SECOND in scene else np.zeros(len(scene), dtype=np.int64)
    if SCANNER in scene and (scene[SCANNER] != scene[SCANNER][:1]).any():
        route = scene[ROUTE].astype(np.int64) if ROUTE in scene else 0
        return (visit << 40) + (route << 20) + scene[SCANNER].astype(np.int64)
    number = np.zeros(len(scene), dtype=np.int64)
    for name in (ROUTE, SOURCE, FILE):
        if name in scene:
            values, rank = rank_integers(scene[name])
            number = number * len(values) + rank
    return (visit << 40) + _of_one_place(scene.xyz, rank_integers(number)[1])


def _of_one_place(xyz: NDArray[np.floating], source: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return the group of each point's source: a source joins the first group whose members it does not overlap."""
    n_sources = int(source.max(initial=0)) + 1
    if n_sources == 1:
        return np.zeros(len(source), dtype=np.int64)
    place = np.floor((xyz[:, :2] - xyz[:, :2].min(axis=0)) / _CELL).astype(np.int64)
    cell = rank_integers(place[:, 0] * (int(place[:, 1].max()) + 1) + place[:, 1])[1]
    pairs = np.unique(cell.astype(np.int64) * n_sources + source)
    seen_by = coo_array((np.ones(len(pairs)), (pairs // n_sources, pairs % n_sources))).tocsr()
    shared = (seen_by.T @ seen_by).toarray()
    overlaps = shared > _SHARED * np.minimum(shared.diagonal()[:, None], shared.diagonal())
    group = np.zeros(n_sources, dtype=np.int64)
    for own in range(1, n_sources):
        taken = set(group[:own][overlaps[own, :own]].tolist())
        group[own] = next(k for k in range(own + 1) if k not in taken)
    return group[source]
