"""Compiled kernels of the final partition: numbering by first point, and adjacency of supervoxels."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def number_by_first_point(
    voxel_of_point: NDArray[np.int32], owner: NDArray[np.int32], n_owners: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], int]:
    """Return the label of each point, the label of each owner (-1 without points), and the number of labels."""
    number = np.full(n_owners, -1, np.int32)
    labels = np.empty(len(voxel_of_point), np.int32)
    n = 0
    for i in range(len(voxel_of_point)):
        s = owner[voxel_of_point[i]]
        if number[s] < 0:
            number[s] = n
            n += 1
        labels[i] = number[s]
    return labels, number, n


@njit(cache=True, nogil=True)
def describe(
    features: NDArray[np.float64],
    group_start: NDArray[np.int64],
    group: NDArray[np.int32],
    number: NDArray[np.int32],
    n_labels: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the mean position and the mean upward normal of the voxels of each label; NaN without normals.

    Each normal is oriented to the sum of the previous ones; within a supervoxel, normals of adjacent voxels almost
    always differ by less than a right angle.
    """
    centroids = np.empty((n_labels, 3), np.float64)
    normals = np.empty((n_labels, 3), np.float64)
    for s in range(len(number)):
        label = number[s]
        if label < 0:
            continue
        x = y = z = a = b = c = 0.0
        for g in range(group_start[s], group_start[s + 1]):
            v = group[g]
            x += features[v, 0]
            y += features[v, 1]
            z += features[v, 2]
            sign = -1.0 if a * features[v, 3] + b * features[v, 4] + c * features[v, 5] < 0.0 else 1.0
            a += sign * features[v, 3]
            b += sign * features[v, 4]
            c += sign * features[v, 5]
        count = np.float64(group_start[s + 1] - group_start[s])
        centroids[label, 0], centroids[label, 1], centroids[label, 2] = x / count, y / count, z / count
        length = np.sqrt(a * a + b * b + c * c)
        if c < 0.0 or (c == 0.0 and (b < 0.0 or (b == 0.0 and a < 0.0))):
            length = -length
        if length == 0.0:
            normals[label, 0] = normals[label, 1] = normals[label, 2] = np.nan
        else:
            normals[label, 0], normals[label, 1], normals[label, 2] = a / length, b / length, c / length
    return centroids, normals


@njit(cache=True, nogil=True)
def group_voxels(voxel_labels: NDArray[np.int32], n_labels: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Return the start of each label, and the voxels sorted by label."""
    start = np.zeros(n_labels + 1, np.int64)
    for v in range(len(voxel_labels)):
        start[voxel_labels[v] + 1] += 1
    for s in range(n_labels):
        start[s + 1] += start[s]
    place = start[:-1].copy()
    voxels = np.empty(len(voxel_labels), np.int32)
    for v in range(len(voxel_labels)):
        s = voxel_labels[v]
        voxels[place[s]] = v
        place[s] += 1
    return start, voxels


@njit(cache=True, nogil=True)
def touching_owners(
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    owner: NDArray[np.int32],
    number: NDArray[np.int32],
    group_start: NDArray[np.int64],
    group: NDArray[np.int32],
    start: int,
    stop: int,
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the counts and the ascending labels of the owners adjacent to each owner of a range.

    The search uses owners, which are numbered along the voxels, for memory locality.
    """
    seen = np.full(len(group_start) - 1, -1, np.int32)
    lengths = np.empty(stop - start, np.int32)
    out = np.empty(16 * (stop - start) + 64, np.int32)
    n = 0
    for s in range(start, stop):
        row = n
        seen[s] = s
        for g in range(group_start[s], group_start[s + 1]):
            v = group[g]
            if n + 26 > len(out):
                larger = np.empty(2 * len(out), np.int32)
                larger[:n] = out[:n]
                out = larger
            for k in range(indptr[v], indptr[v + 1]):
                t = np.uint32(owner[np.uint32(indices[k])])
                if seen[t] != s:
                    seen[t] = s
                    label = number[t]
                    j = n
                    while j > row and out[j - 1] > label:
                        out[j] = out[j - 1]
                        j -= 1
                    out[j] = label
                    n += 1
        lengths[s - start] = n - row
    return lengths, out[:n]


@njit(cache=True, nogil=True)
def order_rows(
    number: NDArray[np.int32], lengths: NDArray[np.int32], rows: NDArray[np.int32], n_labels: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Sort the rows of owners by their labels; return the indptr and indices of a CSR matrix."""
    indptr = np.zeros(n_labels + 1, np.int32)
    for s in range(len(number)):
        if number[s] >= 0:
            indptr[number[s] + 1] = lengths[s]
    for label in range(n_labels):
        indptr[label + 1] += indptr[label]
    indices = np.empty(len(rows), np.int32)
    position = 0
    for s in range(len(number)):
        if number[s] >= 0:
            place = indptr[number[s]]
            for j in range(lengths[s]):
                indices[place + j] = rows[position + j]
            position += lengths[s]
    return indptr, indices
