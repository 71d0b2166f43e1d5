"""Column names of labelling results in every format."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

CLASS, CONFIDENCE, OBJECT = "classification", "confidence", "object_id"
RESULTS = (CLASS, CONFIDENCE, OBJECT)  # columns of the result, in the order of `PointLabels`


class PointLabels(NamedTuple):
    """Results of consecutive points."""

    codes: NDArray[np.uint8]  # LAS classes
    confidence: NDArray[np.float32]  # confidences of the classes, 0 to 1
    object_id: NDArray[np.uint32]  # numbers of the objects in the inventory, 0 for none

    def columns(self) -> dict[str, NDArray]:
        """Return the results by the names of `RESULTS`, in that order."""
        return dict(zip(RESULTS, self, strict=True))


def kept_name(name: str, taken: Sequence[str]) -> str:
    """Return a new name for an input column whose name is reserved for the result, unique among the ``taken`` names."""
    free = f"original_{name}"
    while free in taken:
        free = f"original_{free}"
    return free
