"""Brute-force references for confusion matrices and splatting."""

import numpy as np


def confusion_matrix(truth, predicted, n_classes):
    """Return the confusion matrix, one point at a time."""
    matrix = np.zeros((n_classes, n_classes + 1), dtype=np.int64)
    for t, p in zip(truth, predicted, strict=True):
        if t >= 0:
            matrix[t, p if p >= 0 else n_classes] += 1
    return matrix


def splat(pixels, depth, sides, shape):
    """Draw square splats one pixel at a time; the nearest point wins, ties go to the first."""
    height, width = shape
    nearest = np.full(shape, np.inf)
    winner = np.full(shape, -1)
    for i in range(len(pixels)):
        corner = np.floor(pixels[i] - (sides[i] - 1) / 2.0).astype(int)
        for row in range(corner[1], corner[1] + sides[i]):
            for column in range(corner[0], corner[0] + sides[i]):
                if 0 <= row < height and 0 <= column < width and depth[i] < nearest[row, column]:
                    nearest[row, column] = depth[i]
                    winner[row, column] = i
    return winner, nearest
