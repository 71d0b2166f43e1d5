"""Spin images with a support vector machine, a baseline of Luo et al. 2019 (Johnson and Hebert 1999)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.validation import check_xyz
from mlsroad_pipeline.algorithms.features.spin_image import compute_spin_images
from mlsroad_pipeline.papers.shared.recognition.descriptor_machine import DescriptorRecogniser

SLUG = "spin_image"


class SpinImageRecogniser(DescriptorRecogniser):
    """Recogniser by one spin image of 153 values per object, about the vertical axis through the centre of its box."""

    slug = SLUG

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
