"""Bags of words of objects, and their similarity (Yu et al. 2016, sections IV-B and IV-C)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.core.exceptions import DataError


def count_words(
    words: NDArray[np.integer], objects: NDArray[np.integer], *, n_objects: int, stopped: NDArray[np.bool_]
) -> csr_array:
    """Count the words of each object."""
    if len(words) != len(objects):
        raise DataError(f"{len(words)} words for the objects of {len(objects)} groups")
    keep = ~stopped[words]
    counts = csr_array((np.ones(int(keep.sum())), (objects[keep], words[keep])), shape=(n_objects, len(stopped)))
    counts.sum_duplicates()
    return counts


def inverse_document_frequency(counts: csr_array) -> NDArray[np.float64]:
    """Return log(N / N_i) of each word over the objects of a database (second factor of equation 22)."""
    occurs = np.bincount(counts.indices[counts.data > 0], minlength=counts.shape[1])
    return np.where(occurs > 0, np.log(counts.shape[0] / np.maximum(occurs, 1)), 0.0)


def weigh_words(counts: csr_array, inverse_frequency: NDArray[np.float64]) -> csr_array:
    """Return the bags: term frequency times inverse document frequency (equations 21 and 22)."""
    lengths = np.diff(counts.indptr)
    totals = np.repeat(np.asarray(counts.sum(axis=1)).ravel(), lengths)
    return csr_array(
        (counts.data / totals * inverse_frequency[counts.indices], counts.indices, counts.indptr), shape=counts.shape
    )


def similarity(queries: csr_array, bags: csr_array) -> NDArray[np.float64]:
    """Return the normalised histogram intersection of every query with every bag (equation 23)."""
    if queries.shape[1] != bags.shape[1]:
        raise DataError(f"bags of {queries.shape[1]} and {bags.shape[1]} words cannot be compared")
    return np.asarray(
        _intersections(
            queries.data, queries.indices, queries.indptr, bags.data, bags.indices, bags.indptr, queries.shape[1]
        )
    )


@njit(cache=True, nogil=True)
def _intersections(
    data: NDArray[np.float64], indices: NDArray, indptr: NDArray,
    others: NDArray[np.float64], other_indices: NDArray, other_indptr: NDArray, n_words: int,
) -> NDArray[np.float64]:  # fmt: skip
    """Return equation 23 for sparse bags."""
    n_queries, n_bags = len(indptr) - 1, len(other_indptr) - 1
    out = np.zeros((n_queries, n_bags))
    dense = np.zeros(n_words)
    for q in range(n_queries):
        mass = 0.0
        for k in range(indptr[q], indptr[q + 1]):
            dense[indices[k]] = data[k]
            mass += data[k]
        for b in range(n_bags):
            least, other = 0.0, 0.0
            for k in range(other_indptr[b], other_indptr[b + 1]):
                least += min(dense[other_indices[k]], others[k])
                other += others[k]
            most = mass + other - least  # sum of the maxima
            out[q, b] = least / most if most > 0.0 else 0.0
        for k in range(indptr[q], indptr[q + 1]):
            dense[indices[k]] = 0.0
    return out
