"""What two objects are compared by: their bags of words, their sizes, and where their substance lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.visual_words.bags import similarity
from mlsroad_pipeline.algorithms.visual_words.profiles import profile_likeness
from mlsroad_pipeline.algorithms.visual_words.sizes import SIZES, size_likeness


@dataclass(frozen=True)
class Appearance:
    """How objects look.

    Attributes
    ----------
    bags : csr_array of shape (n, v)
        What `weigh_words` gave.
    sizes : ndarray of float32, shape (n, 4)
        What `measure_sizes` gave.
    profiles : ndarray of float32, shape (n, p)
        What `measure_profiles` gave.
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
            Which ones.

        Returns
        -------
        Appearance
            Those, in the order of the rows.
        """
        return Appearance(self.bags[rows], self.sizes[rows], self.profiles[rows])


def appearance_of(bags: csr_array, sizes: ArrayLike | None, profiles: ArrayLike | None) -> Appearance:
    """Join what objects are compared by.

    Parameters
    ----------
    bags : csr_array of shape (n, v)
        Bags.
    sizes : array-like of shape (n, 4) or None
        Sizes; without, all objects are taken to be of one size.
    profiles : array-like of shape (n, p) or None
        Profiles; without, all objects are taken to have one.

    Returns
    -------
    Appearance
        Them all.

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


def likeness(
    queries: Appearance, objects: Appearance, *, size_share: float, profile_share: float
) -> NDArray[np.float64]:
    """Compare objects with queries.

    Parameters
    ----------
    queries, objects : Appearance
        q and n of them.
    size_share, profile_share : float
        Shares of the likeness of sizes and of that of profiles; the rest is that of bags, equation 23.

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
            alike += size_share * size_likeness(queries.sizes, objects.sizes)
        if profile_share > 0:
            alike += profile_share * profile_likeness(queries.profiles, objects.profiles)
    return alike
