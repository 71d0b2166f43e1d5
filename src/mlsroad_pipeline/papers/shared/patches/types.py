"""Patches of a scene and their labels as stored arrays, and the protocol of patch classifiers."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NotRequired, Protocol, Self, TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters
from mlsroad_pipeline.papers.shared.patches.table import Patches


class ScenePatches(TypedDict):
    """Patches of a scene as stored arrays: the columns of `Patches`, and their relation to the points.

    Attributes
    ----------
    fpfh : ndarray of float32, shape (p, d)
        Histogram of each patch.
    rgb : ndarray of float32, shape (p, 3)
        Mean colour in [0, 1]; absent without colour.
    height : ndarray of float32, shape (p,)
        Height above the local ground in metres.
    centroid : ndarray of float64, shape (p, 3)
        Mean of the points of the patch in metres.
    scene : ndarray of int32, shape (p,)
        Number of the scene.
    label : ndarray of int16, shape (p,)
        Class, -1 if unknown.
    patch_of_point : ndarray of int32, shape (n,)
        Patch of each point; -1 for outliers.
    edges : ndarray of int32, shape (m, 2)
        Pairs of adjacent patches, each pair once.
    """

    fpfh: NDArray[np.float32]
    rgb: NotRequired[NDArray[np.float32]]
    height: NDArray[np.float32]
    centroid: NDArray[np.float64]
    scene: NDArray[np.int32]
    label: NDArray[np.int16]
    patch_of_point: NDArray[np.int32]
    edges: NDArray[np.int32]


class PatchLabels(TypedDict):
    """Classes of the patches of a training scene.

    Attributes
    ----------
    label : ndarray of int16, shape (p,)
        Class of each patch; -1 for patches without labelled core points.
    station : ndarray of float64, shape (p,)
        Station of each patch in metres.
    """

    label: NDArray[np.int16]
    station: NDArray[np.float64]


class PatchClassifier(Protocol):
    """Classifier of patches."""

    def predict_proba(self, patches: Patches, edges: NDArray[np.int32]) -> NDArray[np.floating]:
        """Return the class probabilities of the patches of one scene.

        Parameters
        ----------
        patches : Patches
            The patches, with or without colour.
        edges : ndarray of int32, shape (m, 2)
            Pairs of adjacent patches.

        Returns
        -------
        ndarray of float, shape (n, c)
            Probability of every class of the scheme.
        """

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the learned parameters as named arrays.

        Returns
        -------
        dict of str to ndarray
            The arrays.
        """

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild the classifier from the arrays of `to_arrays`.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            The arrays.

        Returns
        -------
        PatchClassifier
            The classifier.
        """


@dataclass(frozen=True)
class PatchStages:
    """Parameters of the stages before a classifier; a model stores them, and new surveys are prepared with the same.

    Parameters
    ----------
    ground : GroundParameters
        The ground filter.
    patches : PatchParameters
        The patches.
    """

    ground: GroundParameters
    patches: PatchParameters
