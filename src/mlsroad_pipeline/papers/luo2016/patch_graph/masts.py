"""Vertical columns of patches around masts and stems, which separate objects that touch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.graphs import connected_components

BAND = (1.0, 2.5)
"""Heights above ground at which masts are looked for, metres: above plants and below crowns."""

WIDTH, EXTENT = 0.7, 1.0
"""Largest horizontal and least vertical extent of a mast in that band, metres."""

LEAST_IN_BAND = 4
"""Fewest patches of a mast in that band."""


def separate_masts(
    component: NDArray[np.integer],
    positions: NDArray[np.floating],
    edges: NDArray[np.int32],
    above: NDArray[np.bool_],
    *,
    radius: float,
) -> NDArray[np.int64]:
    """Divide components at their masts: the patches within a radius of the axis of a mast are a component of their own.

    A mast is a narrow upright cluster between 1.0 and 2.5 m above ground. It stays with its component if its column
    holds half of the component or more, as the mast of a lamp that stands alone.
    """
    n, height = len(component), positions[:, 2]
    divided = component.astype(np.int64)
    band = above & (height >= BAND[0]) & (height <= BAND[1])
    clusters = connected_components(edges[band[edges].all(axis=1)], n_nodes=n)
    members = _groups(component, above)
    for mast in _groups(clusters, band).values():
        extent = np.ptp(positions[mast], axis=0)
        if len(mast) < LEAST_IN_BAND or extent[:2].max() > WIDTH or extent[2] < EXTENT:
            continue
        own = members[int(component[mast[0]])]
        offset = positions[own, :2] - np.median(positions[mast, :2], axis=0)
        column = own[(offset**2).sum(axis=1) <= radius**2]
        if len(column) < 0.5 * len(own):
            divided[column] = n + clusters[mast[0]]
    return divided


def _groups(number: NDArray[np.integer], chosen: NDArray[np.bool_]) -> dict[int, NDArray[np.int64]]:
    """Return the chosen patches of each number."""
    rows = np.flatnonzero(chosen)
    rows = rows[np.argsort(number[rows], kind="stable")]
    numbers, starts = np.unique(number[rows], return_index=True)
    return dict(zip(numbers.tolist(), np.split(rows, starts[1:]), strict=True)) if len(rows) else {}
