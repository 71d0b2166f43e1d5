"""Split of the ground into paved and natural ground by colour, after a pool that does not use colour.

A logistic regression on the log odds of the pool and on the colour of each voxel. Colours are differences from the
median of the paved ground of the scene, so that the white balance and the exposure of the camera nearly cancel. The
sum of both probabilities stays as it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

PAVED, NATURAL = "paved ground", "natural ground"
"""Names of the classes between which the probability of the ground is divided."""

TERMS = ("log_odds", "green", "green_around", "warm", "warm_around", "bright_around", "bright_warm_around")
"""Names of the terms of the regression, see `split_terms`."""

INTERCEPT = "intercept"

METADATA = "ground_colour"
"""Key of the weights in the metadata of a pool."""

DARK = 8.0
"""Added to the channels before the logarithm, so that the noise of dark points does not count as colour."""

LEAST_SPREAD = 0.01
"""Least standard deviation of green and of warm in a scene; below it in both, its colours are grey or one tint."""

_LEAST_PROBABILITY = 1e-6
_LARGEST_TINT = 0.15, 0.5
_LARGEST_ODDS, _LARGEST_GREEN, _LARGEST_WARM, _LARGEST_BRIGHT = 8.0, 0.4, 0.6, 1.5


def ground_classes(classes: Sequence[str]) -> tuple[int, int]:
    """Return the numbers of paved and natural ground."""
    return classes.index(PAVED), classes.index(NATURAL)


def natural_share(terms: Mapping[str, NDArray[np.float64]], weights: Mapping[str, float]) -> NDArray[np.float64]:
    """Return the share of natural ground in the probability of the ground."""
    score = np.full(len(terms[TERMS[0]]), float(weights[INTERCEPT]))
    for name, values in terms.items():
        score += float(weights[name]) * values
    return 1.0 / (1.0 + np.exp(-score))


def ground_terms(
    probabilities: NDArray[np.floating], labels: NDArray[np.integer], classes: tuple[int, int],
    rgb: NDArray[np.uint8], owner: NDArray[np.int32], region: NDArray[np.integer],
) -> tuple[NDArray[np.intp], dict[str, NDArray[np.float64]]]:  # fmt: skip
    """Return the terms of the regression for the voxels of ground that have a colour."""
    sums = colour_sums(rgb, owner, (labels == classes[0]) | (labels == classes[1]))
    rows = np.flatnonzero(sums[:, 3])
    own, of_region = sums[rows], region[rows]
    around = np.stack([np.bincount(of_region, own[:, k]) for k in range(4)], axis=1)
    colour, colour_around = _colour(own), _colour(around)[of_region]
    if not len(rows) or colour[:, :2].std(axis=0).max() < LEAST_SPREAD:
        rows, colour, colour_around = rows[:0], colour[:0], colour_around[:0]
    paved, natural = (np.maximum(probabilities[rows, column], _LEAST_PROBABILITY) for column in classes)
    odds = np.log(natural / paved)
    reference = _reference(colour_around, odds < 0)
    return rows, split_terms(odds, colour - reference, colour_around - reference)


def split_terms(
    odds: NDArray[np.float64], colour: NDArray[np.float64], around: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """Return the terms of the regression."""
    green, green_around = (np.clip(each[:, 0], -_LARGEST_GREEN, _LARGEST_GREEN) for each in (colour, around))
    warm, warm_around = (np.clip(each[:, 1], -_LARGEST_WARM, _LARGEST_WARM) for each in (colour, around))
    bright = np.clip(around[:, 2], -_LARGEST_BRIGHT, _LARGEST_BRIGHT)
    return {
        "log_odds": np.clip(odds, -_LARGEST_ODDS, _LARGEST_ODDS),
        "green": green,
        "green_around": green_around,
        "warm": warm,
        "warm_around": warm_around,
        "bright_around": bright,
        "bright_warm_around": bright * warm_around,
    }


@njit(cache=True, nogil=True)
def colour_sums(rgb: NDArray[np.uint8], owner: NDArray[np.int32], chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the sums of the colours of each chosen voxel, and its number of points that are not black."""
    sums = np.zeros((len(chosen), 4), np.int64)
    for i in range(len(owner)):
        row = owner[i]
        if row < 0 or not chosen[row]:
            continue
        red, green, blue = np.int64(rgb[i, 0]), np.int64(rgb[i, 1]), np.int64(rgb[i, 2])
        if red + green + blue > 0:
            sums[row, 0] += red
            sums[row, 1] += green
            sums[row, 2] += blue
            sums[row, 3] += 1
    return sums


def _colour(sums: NDArray[np.number]) -> NDArray[np.float64]:
    """Return green, warm and bright of sums of colours."""
    red, green, blue = np.log(sums[:, :3] / np.maximum(sums[:, 3:], 1) + DARK).T
    return np.stack([green - (red + blue) / 2, red - blue, (red + green + blue) / 3], axis=1)


def _reference(colour: NDArray[np.float64], paved: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the median colour of the paved ground; its tint is bounded, since it may hold natural ground."""
    if not len(colour):
        return np.zeros(3)
    middle = np.median(colour[paved] if paved.any() else colour, axis=0)
    return np.clip(middle, [-_LARGEST_TINT[0], -_LARGEST_TINT[1], 0.0], [*_LARGEST_TINT, 10.0])
