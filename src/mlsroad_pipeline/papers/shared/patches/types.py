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

    `patch_of_point` is -1 for outliers; `edges` has each pair of adjacent patches once.
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
    """Classes (-1 without labelled core points) and stations in metres of the patches of a training scene."""

    label: NDArray[np.int16]
    station: NDArray[np.float64]


class PatchClassifier(Protocol):
    """Classifier of patches."""

    def predict_proba(self, patches: Patches, edges: NDArray[np.int32]) -> NDArray[np.floating]:
        """Return the probability of every class of the scheme for the patches of one scene, with or without colour."""

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the learned parameters as named arrays."""

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild the classifier from the arrays of `to_arrays`."""


@dataclass(frozen=True)
class PatchStages:
    """Parameters of the stages before a classifier; a model stores them, and new surveys are prepared with the same."""

    ground: GroundParameters
    patches: PatchParameters
