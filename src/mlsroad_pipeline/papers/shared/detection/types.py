"""Described objects and detections."""

from collections.abc import Mapping
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.segmentation.stage import Segments

__all__ = ["Description", "Detections", "ObjectLabels", "Segments", "object_bounds"]

Description = Mapping[str, NDArray]
"""Described objects of a scene. ``objects`` int32 (g,): object of each part, ascending; ``n_objects``; ``intensity``:
whether the scene has it. All other arrays have one row per part and belong to the method: see `describe_parts`,
`describe_surfaces` and `visual_words.groups.describe_objects`."""


class ObjectLabels(TypedDict):
    """Detected class and score of each object of a scene."""

    label: NDArray[np.int16]  # Index in the wanted classes; -1 for none
    score: NDArray[np.float32]  # Score of that class; 0 for none


class Detections(ObjectLabels):
    """Detections in a scene with the scores of all classes."""

    scores: NDArray[np.float32]  # Score of each object for each wanted class; 0 is no similarity at all


def object_bounds(parts: Description) -> NDArray[np.int64]:
    """Return the index of the first part of each object, and the number of parts, shape (n_objects + 1,)."""
    return np.searchsorted(parts["objects"], np.arange(int(parts["n_objects"]) + 1)).astype(np.int64)
