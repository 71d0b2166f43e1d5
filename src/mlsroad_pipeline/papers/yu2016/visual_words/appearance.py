"""Appearance of objects: bags of words, sizes and profiles, and their similarity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.papers.yu2016.visual_words.bags import similarity
from mlsroad_pipeline.papers.yu2016.visual_words.profiles import profile_similarity
from mlsroad_pipeline.papers.yu2016.visual_words.sizes import SIZES, size_similarity


@dataclass(frozen=True)
class Appearance:
    """Bags of words, sizes and profiles of objects."""

    bags: csr_array  # Bags, see `weigh_words`
    sizes: NDArray[np.float32]  # Sizes, see `measure_sizes`
    profiles: NDArray[np.float32]  # Profiles, see `measure_profiles`

    def __len__(self) -> int:
        """Return the number of objects."""
        return len(self.sizes)

    def select(self, rows: NDArray) -> Appearance:
        """Return some of the objects."""
        return Appearance(self.bags[rows], self.sizes[rows], self.profiles[rows])


def appearance_of(bags: csr_array, sizes: ArrayLike | None, profiles: ArrayLike | None) -> Appearance:
    """Return the appearance of objects."""
    n = bags.shape[0]
    large = np.ones((n, len(SIZES)), np.float32) if sizes is None else np.asarray(sizes, dtype=np.float32)
    if large.shape != (n, len(SIZES)):
        raise DataError(f"{n} objects need sizes of shape ({n}, {len(SIZES)}), got {large.shape}")
    spread = np.ones((n, 1), np.float32) if profiles is None else np.asarray(profiles, dtype=np.float32)
    if spread.ndim != 2 or len(spread) != n:
        raise DataError(f"{n} objects need one profile each, got an array of shape {spread.shape}")
    return Appearance(bags, large, spread)


def appearance_similarity(
    queries: Appearance, objects: Appearance, *, size_share: float, profile_share: float
) -> NDArray[np.float64]:
    """Return the similarity of objects to queries."""
    share = 1.0 - size_share - profile_share
    alike = similarity(queries.bags, objects.bags)
    if share < 1:
        alike = share * alike
        if size_share > 0:
            alike += size_share * size_similarity(queries.sizes, objects.sizes)
        if profile_share > 0:
            alike += profile_share * profile_similarity(queries.profiles, objects.profiles)
    return alike
