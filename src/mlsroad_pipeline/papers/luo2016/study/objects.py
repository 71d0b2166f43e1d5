"""Points, objects and touching objects of a street (Table I of Luo et al. 2016)."""

from __future__ import annotations

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.machines.class_balance import majority_labels
from mlsroad_pipeline.papers.shared.patches.types import ScenePatches

LEAST_POINTS = 100
"""Fewest points of an object that is counted; most objects with fewer are cut off at an end of the street."""


class StreetCounts(TypedDict):
    """Counts of a street by class, each of shape (classes,)."""

    points: NDArray[np.int64]
    objects: NDArray[np.int64]  # instances of the simulator
    touching: NDArray[np.int64]  # objects with a patch beside a patch of another object


def count_street(points: PointCloud, patches: ScenePatches, scheme: ClassScheme) -> StreetCounts:
    """Count the points and objects of each class; ground has no objects."""
    labels, n = scheme.encode(points["label"], source=points.source), len(scheme)
    names, instance = np.unique(points["instance"], return_inverse=True)
    whole = np.bincount(instance) >= LEAST_POINTS
    kinds, _ = majority_labels(labels, instance, n)
    counted = whole & (names > 0) & (kinds >= 0)
    owner = patches["patch_of_point"]
    known = owner >= 0
    objects = np.full(len(patches["height"]), -1)
    most, _ = majority_labels(instance[known], owner[known], len(names))
    objects[: len(most)] = most
    pairs = objects[patches["edges"]]
    both = pairs[(pairs[:, 0] != pairs[:, 1]) & counted[pairs].all(axis=1)]
    near = np.zeros(len(names), np.bool_)
    near[both] = True
    return {
        "points": np.bincount(labels[labels >= 0], minlength=n),
        "objects": np.bincount(kinds[counted], minlength=n),
        "touching": np.bincount(kinds[counted & near], minlength=n),
    }
