"""SHOT descriptors with a support vector machine, a baseline of Luo et al. 2019 (Tombari et al. 2010)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.validation import check_xyz
from mlsroad_pipeline.algorithms.features.normals import compute_normals
from mlsroad_pipeline.algorithms.features.shot import SIZE, compute_shot
from mlsroad_pipeline.papers.shared.recognition.descriptor_machine import DescriptorRecogniser

SLUG = "shot"
N_NEIGHBORS = 10
"""Neighbours for the estimation of normals."""


class ShotRecogniser(DescriptorRecogniser):
    """Recogniser by one SHOT descriptor of 352 values per object, at its centroid; normals point away from it."""

    slug = SLUG

    @staticmethod
    def describe_objects(objects: Sequence[ArrayLike], radius: float) -> NDArray[np.float32]:
        """Return the descriptors of objects."""
        descriptors = np.zeros((len(objects), SIZE), dtype=np.float32)
        for i, xyz in enumerate(objects):
            points = check_xyz(xyz, minimum=1, name=f"object {i}").astype(np.float64)
            points = points - points.mean(axis=0)
            normals = -compute_normals(points, k=min(N_NEIGHBORS, len(points)), viewpoint=np.zeros(3))
            reach = radius or max(np.linalg.norm(points, axis=1).max(), 1e-3)
            descriptors[i] = compute_shot(points, normals, np.zeros(3), radius=reach)
        return descriptors
