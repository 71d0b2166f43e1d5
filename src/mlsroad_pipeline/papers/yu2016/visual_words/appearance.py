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
    """Bags of words, sizes and profiles of objects.

    Attributes
    ----------
    bags : csr_array of shape (n, v)
        Bags, see `weigh_words`.
    sizes : ndarray of float32, shape (n, 4)
        Sizes, see `measure_sizes`.
    profiles : ndarray of float32, shape (n, p)
        Profiles, see `measure_profiles`.
    """

    bags: csr_array
    sizes: NDArray[np.float32]
    profiles: NDArray[np.float32]

    def __len__(self) -> int:
        """Return the number of objects."""
        return len(self.sizes)

    def select(self, rows: NDArray) -> Appearance:
        """Return some of the objects.

        Parameters
        ----------
        rows : ndarray
            Indices of the objects.

        Returns
        -------
        Appearance
            The objects, in the order of the indices.
        """
        return Appearance(self.bags[rows], self.sizes[rows], self.profiles[rows])


def appearance_of(bags: csr_array, sizes: ArrayLike | None, profiles: ArrayLike | None) -> Appearance:
    """Return the appearance of objects.

    Parameters
    ----------
    bags : csr_array of shape (n, v)
        Bags.
    sizes : array-like of shape (n, 4) or None
        Sizes; None gives all objects the same size.
    profiles : array-like of shape (n, p) or None
        Profiles; None gives all objects the same profile.

    Returns
    -------
    Appearance
        Bags, sizes and profiles.

    Raises
    ------
    DataError
        If there is not one size or profile per object.
    """
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
    """Return the similarity of objects to queries.

    Parameters
    ----------
    queries, objects : Appearance
        q queries and n objects.
    size_share, profile_share : float
        Weights of the similarity of sizes and of profiles; the remaining weight is that of bags, equation 23.

    Returns
    -------
    ndarray of float64, shape (q, n)
        In [0, 1].

    Raises
    ------
    DataError
        If vocabularies or profiles differ.
    """
    share = 1.0 - size_share - profile_share
    alike = similarity(queries.bags, objects.bags)
    if share < 1:
        alike = share * alike
        if size_share > 0:
            alike += size_share * size_similarity(queries.sizes, objects.sizes)
        if profile_share > 0:
            alike += profile_share * profile_similarity(queries.profiles, objects.profiles)
    return alike
