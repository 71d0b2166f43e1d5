"""Hierarchy descriptor with a support vector machine, a baseline of Luo et al. 2019 (Bertrand 2009)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.features.layers import describe_layers
from mlsroad_pipeline.papers.shared.recognition.descriptor_machine import DescriptorRecogniser

SLUG = "hierarchy_descriptor"


class HierarchyRecogniser(DescriptorRecogniser):
    """Recogniser by ten features of each of ten layers of an object.

    The descriptor is published in a thesis only. Luo et al. describe it as 100 values that model the typical vertical
    features of a shape; this implementation follows that description.
    """

    slug = SLUG
    has_radius = False

    @staticmethod
    def describe_objects(objects: Sequence[ArrayLike], radius: float) -> NDArray[np.float32]:
        """Return the descriptors of objects."""
        del radius
        return describe_layers(objects)
