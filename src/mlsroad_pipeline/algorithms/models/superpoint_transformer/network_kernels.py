"""Compiled kernels of the network in use: normalisation, pooling and attention in float32."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

_FAST = {"reassoc", "contract", "arcp", "nsz"}
_EPSILON = np.float32(1e-5)
_SLOPE = np.float32(0.01)
_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)
_LOWEST = np.float32(-1e30)


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def normalise(rows: NDArray, bias: NDArray, gain: NDArray, shift: NDArray, slope: np.float32) -> None:
    """Add the bias to rows and replace them by their layer normalisation; negative values are multiplied by `slope`."""
    width = rows.shape[1]
    share = _ONE / np.float32(width)
    for i in range(rows.shape[0]):
        total = _ZERO
        for j in range(width):
            rows[i, j] += bias[j]
            total += rows[i, j]
        mean = total * share
        squared = _ZERO
        for j in range(width):
            centred = rows[i, j] - mean
            squared += centred * centred
        factor = _ONE / np.sqrt(squared * share + _EPSILON)
        for j in range(width):
            value = (rows[i, j] - mean) * factor * gain[j] + shift[j]
            rows[i, j] = value if value > _ZERO else slope * value


@njit(cache=True, nogil=True)
def raise_to_rows(rows: NDArray, owner: NDArray, out: NDArray) -> None:
    """Raise the row of `out` of each owner to the maximum of itself and the owner's rows."""
    for i in range(rows.shape[0]):
        group = owner[i]
        for j in range(rows.shape[1]):
            out[group, j] = rows[i, j] if rows[i, j] > out[group, j] else out[group, j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def write_logits(
    own: NDArray,
    changes: NDArray,
    source: NDArray,
    indptr: NDArray,
    targets: tuple[int, int],
    keys: tuple[int, ...],
    out: NDArray,
) -> None:
    """Write the logits of the edges of a range of targets, less the largest of each target and head.

    `own`, shape (n, components, heads), has queries, keys and values of the superpoints, `changes` those of the edges
    of these targets.
    """
    n_heads, start = out.shape[1], indptr[targets[0]]
    top = np.empty(n_heads, np.float32)
    for t in range(targets[0], targets[1]):
        top[:] = _LOWEST
        for i in range(indptr[t] - start, indptr[t + 1] - start):
            s = source[start + i]
            for h in range(n_heads):
                logit = _ZERO
                for c in range(len(keys)):
                    query = own[t, c, h] + changes[i, c, h]
                    logit += query * (own[s, len(keys) + c, h] + changes[i, len(keys) + c, h])
                out[i, h] = logit
            for h in range(n_heads):
                top[h] = out[i, h] if out[i, h] > top[h] else top[h]
        for i in range(indptr[t] - start, indptr[t + 1] - start):
            for h in range(n_heads):
                out[i, h] -= top[h]


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def write_means(
    own: NDArray,
    changes: NDArray,
    source: NDArray,
    indptr: NDArray,
    targets: tuple[int, int],
    keys: tuple[int, ...],
    values: tuple[int, ...],
    weights: NDArray,
    out: NDArray,
) -> None:
    """Write the weighted means of the values of the edges of a range of targets; see `write_logits`.

    `values` has an entry per component of a value. Targets without edges get 0.
    """
    n_heads, start = out.shape[2], indptr[targets[0]]
    total = np.empty(n_heads, np.float32)
    for t in range(targets[0], targets[1]):
        total[:] = _ZERO
        out[t] = _ZERO
        for i in range(indptr[t] - start, indptr[t + 1] - start):
            s = source[start + i]
            for h in range(n_heads):
                total[h] += weights[i, h]
            for c in range(len(values)):
                for h in range(n_heads):
                    out[t, c, h] += weights[i, h] * (own[s, 2 * len(keys) + c, h] + changes[i, 2 * len(keys) + c, h])
        if indptr[t + 1] > indptr[t]:
            for c in range(len(values)):
                for h in range(n_heads):
                    out[t, c, h] /= total[h]
