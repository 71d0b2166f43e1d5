"""Cutting and thinning of training scenes for the match graph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive
from mlsroad_pipeline.papers.shared.patches.labelling import main_axis_stations
from mlsroad_pipeline.papers.shared.patches.table import Patches


def cut_scenes(patches: Patches, length: float) -> Patches:
    """Cut scenes by station into shorter scenes of about equal length.

    Matches come from different scenes; short scenes allow a patch more matches within one street. Patches without
    stations are cut along the main horizontal axis of their scene.
    """
    check_positive(length, "scene_length")
    pieces = np.empty(len(patches), np.int32)
    n_pieces = 0
    for scene in np.unique(patches.scene):
        members = np.flatnonzero(patches.scene == scene)
        if patches.station is None:
            along = main_axis_stations(patches.centroid[members])
        else:
            along = patches.station[members] - patches.station[members].min()
        count = max(1, round(float(along.max()) / length))
        places = np.minimum((along / max(along.max(), length) * count).astype(np.int32), count - 1)
        pieces[members] = n_pieces + places
        n_pieces += count
    return patches.with_columns(scene=pieces)


def thin_scenes(
    patches: Patches, edges: NDArray[np.int32], *, n_patches: int, seed: int
) -> tuple[Patches, NDArray[np.int32]]:
    """Thin scenes with too many patches by a random sample stratified by class."""
    check_at_least(n_patches, 1, "max_patches")
    random = np.random.default_rng(seed)
    # Every k-th patch in the order of scene, class and a random key is a sample stratified by class.
    order = np.lexsort((random.random(len(patches)), patches.label, patches.scene))
    sizes = np.bincount(patches.scene)
    rank = np.arange(len(patches)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    share = np.minimum(n_patches / np.maximum(sizes, 1), 1.0)[patches.scene[order]]
    drawn = np.zeros(len(patches), bool)
    drawn[order] = np.floor((rank + 1) * share + 1e-9) > np.floor(rank * share + 1e-9)
    if drawn.all():
        return patches, edges
    place = np.where(drawn, np.cumsum(drawn) - 1, -1).astype(np.int32)[edges]
    return patches.take(np.flatnonzero(drawn)), place[(place >= 0).all(axis=1)]
