"""Higher-order cliques of the patches of separate objects (robust P^n Potts model, Kohli et al. 2009).

Luo et al. 2016 name higher-order potentials as future work (section V).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.energy.robust_potts import Cliques
from mlsroad_pipeline.algorithms.geometry.graphs import connected_components
from mlsroad_pipeline.papers.luo2016.patch_graph.masts import separate_masts

LEAST_PATCHES = 4
"""Fewest patches of a clique."""


@dataclass(frozen=True)
class GroundClasses:
    """Ground classes with special weights in equation 11."""

    grass: int = -1  # Labels, possibly equal; -1 if the scheme lacks the class
    road: int = -1  # Labels, possibly equal; -1 if the scheme lacks the class


def object_cliques(
    labels: NDArray[np.integer],
    edges: NDArray[np.int32],
    n_classes: int,
    *,
    ground: GroundClasses,
    weight: float,
    truncation: float,
    positions: NDArray[np.floating] | None = None,
    mast_radius: float = 0.0,
) -> Cliques:
    """Return a clique for each connected component of the patches that are neither grass nor road."""
    n = len(labels)
    rows = np.flatnonzero((labels != ground.grass) & (labels != ground.road))
    above = np.zeros(n, np.bool_)
    above[rows] = True
    number = connected_components(edges[above[edges].all(axis=1)], n_nodes=n).astype(np.int64)
    if mast_radius > 0:
        if positions is None:
            raise ParameterError("mast_radius needs the positions of the patches")
        number = separate_masts(number, positions, edges, above, radius=mast_radius)
    component = np.unique(number[rows], return_inverse=True)[1]
    sizes = np.bincount(component)
    ordered = np.argsort(component, kind="stable")
    large = sizes >= LEAST_PATCHES
    members = rows[ordered][large[component[ordered]]].astype(np.int32)
    counts = sizes[large]
    return Cliques(
        np.concatenate([[0], np.cumsum(counts)]),
        members,
        np.zeros((len(counts), n_classes)),
        np.multiply(counts, weight, dtype=np.float64),
        np.multiply(counts, truncation, dtype=np.float64),
    )


def clique_support(cliques: Cliques, labels: NDArray[np.integer], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return what each label saves a patch in its clique, given the labels of the others."""
    support = np.zeros(shape)
    owner = np.repeat(np.arange(len(cliques)), np.diff(cliques.indptr))
    counts = np.zeros((len(cliques), shape[1]))
    np.add.at(counts, (owner, labels[cliques.members]), 1.0)
    most = counts.argmax(axis=1) if len(cliques) else np.zeros(0, np.int64)
    deviating = np.diff(cliques.indptr) - counts.max(axis=1, initial=0.0)
    rate = np.where(deviating < cliques.truncation, cliques.maximum / cliques.truncation, 0.0)
    support[cliques.members, most[owner]] = rate[owner]
    return support
