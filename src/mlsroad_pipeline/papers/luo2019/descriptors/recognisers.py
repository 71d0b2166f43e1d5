"""Descriptors with a support vector machine, baselines of Luo et al. 2019."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.validation import check_xyz
from mlsroad_pipeline.algorithms.features.layers import describe_layers
from mlsroad_pipeline.algorithms.features.normals import compute_normals
from mlsroad_pipeline.algorithms.features.shot import SIZE, compute_shot
from mlsroad_pipeline.algorithms.features.spin_image import compute_spin_images
from mlsroad_pipeline.papers.shared.recognition.descriptor_machine import DescriptorRecogniser

N_NEIGHBORS = 10
"""Neighbours for the estimation of normals."""


class SpinImageRecogniser(DescriptorRecogniser):
    """Recogniser by one spin image of 153 values per object, about the vertical axis through the centre of its box.

    After Johnson and Hebert 1999.
    """

    slug = "spin_image"

    @staticmethod
    def describe_objects(objects: Sequence[ArrayLike], radius: float) -> NDArray[np.float32]:
        """Return the descriptors of objects."""
        images = np.zeros((len(objects), 153), dtype=np.float32)
        for i, xyz in enumerate(objects):
            points = check_xyz(xyz, minimum=1, name=f"object {i}").astype(np.float64)
            points = points - 0.5 * (points.min(axis=0) + points.max(axis=0))
            reach = radius or max(np.hypot(points[:, 0], points[:, 1]).max(), np.abs(points[:, 2]).max(), 1e-3)
            search = np.sqrt(2.0) * reach * (1.0 + 1e-9)  # the cylinder of the image lies inside the ball
            images[i] = compute_spin_images(points, [[0.0, 0.0, 1.0]], radius=search, queries=np.zeros((1, 3)))[0]
        return images


class ShotRecogniser(DescriptorRecogniser):
    """Recogniser by one SHOT descriptor of 352 values per object, at its centroid; normals point away from it.

    After Tombari et al. 2010.
    """

    slug = "shot"

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


class HierarchyRecogniser(DescriptorRecogniser):
    """Recogniser by ten features of each of ten layers of an object.

    The descriptor is published in a thesis only (Bertrand 2009). Luo et al. describe it as 100 values that model the
    typical vertical features of a shape; this implementation follows that description.
    """

    slug = "hierarchy_descriptor"
    has_radius = False

    @staticmethod
    def describe_objects(objects: Sequence[ArrayLike], radius: float) -> NDArray[np.float32]:
        """Return the descriptors of objects."""
        del radius
        return describe_layers(objects)
