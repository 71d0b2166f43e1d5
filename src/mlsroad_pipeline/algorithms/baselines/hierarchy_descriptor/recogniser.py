"""Hierarchy descriptor with a support vector machine, a rival of Luo et al. 2019 (Bertrand 2009)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.features.layers import describe_layers
from mlsroad_pipeline.algorithms.recognition.descriptor_machine import DescriptorRecogniser

SLUG = "hierarchy_descriptor"


class HierarchyRecogniser(DescriptorRecogniser):
    """Ten numbers for each of ten layers of an object.

    The descriptor is known from a thesis alone; Luo et al. call it a model of the typical vertical features of a shape,
    of 100 numbers. This reading keeps both.

    Parameters
    ----------
    parameters : DescriptorParameters, optional
        What is chosen from.
    """

    slug = SLUG
    has_radius = False

    @staticmethod
    def describe_objects(objects: Sequence[ArrayLike], radius: float) -> NDArray[np.float32]:
        """Describe objects.

        Parameters
        ----------
        objects : sequence of array-like of shape (n_i, 3)
            Points of each object, metres.
        radius : float
            Not used.

        Returns
        -------
        ndarray of float32, shape (objects, 100)
            The descriptors.
        """
        del radius
        return describe_layers(objects)
