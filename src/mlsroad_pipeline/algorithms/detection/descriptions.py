"""What detectors see of the objects of a scene."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Description = Mapping[str, NDArray]
"""Parts of the objects of a scene: arrays with one row per part, ordered by object; ``objects`` int32, the object of
each part; ``n_objects``; ``intensity``, whether the scene has it."""


def object_bounds(parts: Description) -> NDArray[np.int64]:
    """Return where the parts of each object begin, (n_objects + 1,)."""
    return np.searchsorted(parts["objects"], np.arange(int(parts["n_objects"]) + 1)).astype(np.int64)
