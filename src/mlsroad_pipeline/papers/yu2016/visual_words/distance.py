"""Discriminant group distance (Yu et al. 2016, section III-E), and exact nearest-word search.

The distance is the product of a factor of orientations and scales and a sum of Mahalanobis distances. Neither is a
metric, but both have lower bounds for a whole cell of words: the factor by the ranges of the words' angles and ratios,
the sum by the bounding box of their sorted features. Cells that cannot contain a nearer word are skipped; the result
equals that of an exhaustive search.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.papers.yu2016.visual_words._cells import (
    DIRECTIONS,
    Cells,
    Context,
    build_cells,
    orders,
    prepare,
    search,
    sorted_features,
)
from mlsroad_pipeline.papers.yu2016.visual_words.groups import ContextualGroups

CONTEXT_FLOOR = 0.05
"""Least value of the context factor 1 - SCSim. With 0, as printed, groups of equal context have distance 0."""

_NO_VARIANCE = 1e-14  # variance of a constant feature after rounding


def inverse_covariance(descriptors: NDArray, *, rcond: float = 1e-6) -> NDArray[np.float64]:
    """Return the pseudo-inverse of the covariance over all features (A^-1 of equation 16).

    The covariance is singular by construction: the three shape features sum to 1, and so does the FPFH. Directions
    whose variance is below the share `rcond` of the largest are excluded.
    """
    rows = np.asarray(descriptors, dtype=np.float64).reshape(-1, np.shape(descriptors)[-1])
    if len(rows) == 0:
        raise DataError("a covariance needs features, got none")
    if not np.isfinite(rows).all():
        raise DataError(f"a covariance needs finite features, {int((~np.isfinite(rows)).any(axis=1).sum())} are not")
    values, vectors = np.linalg.eigh(np.cov(rows, rowvar=False, bias=True))
    keep = values > max(rcond * values[-1], _NO_VARIANCE)
    return np.asarray((vectors[:, keep] / values[keep]) @ vectors[:, keep].T, dtype=np.float64)


def _whitening(inverse: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return L with L L^T the inverse covariance, without its null directions."""
    values, vectors = np.linalg.eigh(inverse)
    keep = values > 1e-12 * max(float(values.max()), 1e-300)
    if not keep.any():
        return np.zeros((len(inverse), 1))
    return np.asarray(vectors[:, keep] * np.sqrt(values[keep]), dtype=np.float64)


@dataclass(frozen=True)
class WordIndex:
    """Search index of a vocabulary; `floor` is the least value of the context factor."""

    words: ContextualGroups
    inverse: NDArray[np.float64]
    floor: float = CONTEXT_FLOOR

    def __post_init__(self) -> None:
        if len(self.words) == 0:
            raise DataError("the vocabulary has no words")
        if not 0 <= self.floor <= 1:
            raise ParameterError(f"floor must be between 0 and 1, got {self.floor!r}")

    def context(self, groups: ContextualGroups) -> Context:
        """Return groups prepared for the distance."""
        if groups.descriptors.shape[1:] != self.words.descriptors.shape[1:]:
            raise DataError(
                f"groups of shape {groups.descriptors.shape[1:]} cannot be compared with words of shape "
                f"{self.words.descriptors.shape[1:]}"
            )
        return prepare(groups.descriptors, groups.orientations, groups.scales, self._whitening)

    @cached_property
    def _whitening(self) -> NDArray[np.float64]:
        return _whitening(self.inverse)

    @cached_property
    def _cells(self) -> tuple[Cells, Context, NDArray[np.float64]]:
        """Cells, words in their order, and principal axes of the cells' coordinates."""
        known = self.context(self.words)
        rows = sorted_features(known)
        _, axes = np.linalg.eigh(np.cov(rows, rowvar=False, bias=True).reshape(rows.shape[1], -1))
        cells = build_cells(rows @ axes[:, ::-1], known)
        ordered = Context(*(np.ascontiguousarray(part[cells.order]) for part in known))
        return cells, ordered, np.ascontiguousarray(axes[:, ::-1][:, :DIRECTIONS])

    def search(self, groups: ContextualGroups, *, n_threads: int = 1) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Return the nearest word of each group, of equally near ones the first, and the discriminant group distance to
        it.
        """
        check_at_least(n_threads, 1, "n_threads")
        wanted = self.context(groups)
        words, distances = np.empty(len(groups), np.int32), np.empty(len(groups))
        cells, ordered, axes = self._cells
        places = (sorted_features(wanted) @ axes).astype(np.float32)
        matching = orders(groups.scales.shape[1])

        def work(first: int, stop: int) -> None:
            search(wanted, places, ordered, cells, matching, self.floor, first, stop, words, distances)

        limits = [len(groups) * t // n_threads for t in range(n_threads + 1)]
        if n_threads == 1:
            work(0, len(groups))
        else:
            with ThreadPoolExecutor(n_threads) as pool:
                list(pool.map(work, limits[:-1], limits[1:]))
        return words, distances
