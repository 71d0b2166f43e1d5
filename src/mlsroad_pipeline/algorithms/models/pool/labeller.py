"""Log-linear pool of trained labellers with one weight each.

The probability of a class is proportional to the product of those of the members, each raised to the power of the
member's weight (Tomic et al. 2019, section 2.3, with one weight per method in place of matrices). Members see the same
points and describe them in different ways, so their errors differ.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.labels import unlabelled
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.familiarity import familiarity_of
from mlsroad_pipeline.algorithms.models.labelling import SoftLabels, label_softly, labels_of_rows, stored_member
from mlsroad_pipeline.algorithms.models.machines.combinations import decide, largest_of_rows, rank_pairs

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


SLUG = "pool"

TREES, NETWORK = "trees", "network"
"""Names of the members of the shipped pool."""

FLOOR = 1e-4
"""Least probability of a member: a class that one member excludes is not excluded by the pool."""

_SHARED = ("scheme", "parameters", "trained_on", "training_facts", "learned")  # metadata of the first member


def pool_bundle(members: Mapping[str, ModelBundle], weights: Mapping[str, float]) -> ModelBundle:
    """Return the pool of several models as one."""
    first = next(iter(members.values()))
    merged = {name: _merged(name, one, first) for name, one in members.items() if one.classes != first.classes}
    if set(weights) != set(members) or abs(sum(weights.values()) - 1.0) > 1e-6 or min(weights.values()) < 0:
        raise ParameterError(f"pool: the weights of {', '.join(members)} must be from 0 to 1 with the sum 1: {weights}")
    arrays = {f"{name}/{key}": values for name, member in members.items() for key, values in member.arrays.items()}
    shared = {key: first.metadata[key] for key in _SHARED if key in first.metadata}
    attributes = [name for member in members.values() for name in member.metadata.get("attributes", ())]
    metadata = {
        **shared,
        "classes": list(first.classes),
        "attributes": sorted(set(attributes) & set(first.metadata.get("attributes", ()))),
        "weights": {name: float(weights[name]) for name in members},
        "members": {name: {**member.metadata, "slug": member.slug} for name, member in members.items()},
        **({"merged": merged} if merged else {}),
    }
    return ModelBundle(SLUG, arrays, metadata)


def with_trees(bundle: ModelBundle, trees: ModelBundle) -> ModelBundle:
    """Return a pool of trees and a network with other trees."""
    pool = familiarity_of(bundle, pool_bundle({**members_of(bundle), TREES: trees}, bundle.metadata["weights"]))
    weights = bundle.metadata.get(METADATA)
    return pool if weights is None else with_ground_colour(pool, weights)


def with_ground_colour(bundle: ModelBundle, weights: Mapping[str, float]) -> ModelBundle:
    """Return a pool that divides the ground into paved and natural ground by colour where a survey has one."""
    if not {PAVED, NATURAL} <= set(bundle.classes):
        return bundle
    return replace(bundle, metadata={**bundle.metadata, METADATA: dict(weights)})


def _merged(name: str, member: ModelBundle, first: ModelBundle) -> list[int]:
    """Return the class of the first member that holds each class of another one."""
    try:
        table = bundle_scheme(member).coarsen(bundle_scheme(first))
    except ParameterError as error:
        raise ParameterError(f"pool: {name!r} has other classes than the first member: {error}") from error
    if (table == IGNORE).any():
        raise ParameterError(f"pool: {name!r} has classes that the first member ignores")
    return [int(label) for label in table]


def members_of(bundle: ModelBundle) -> dict[str, ModelBundle]:
    """Return the models of a pool."""
    if SLUG not in bundle.prepared:
        stored: Mapping[str, Any] = bundle.metadata.get("members", {})
        weights = bundle.metadata.get("weights", {})
        if not stored or set(weights) != set(stored):
            raise DataError(f"model {bundle.slug!r}: its members and weights do not agree: the model is damaged")
        bundle.prepared[SLUG] = {name: stored_member(bundle, name) for name in weights}
    found: dict[str, ModelBundle] = bundle.prepared[SLUG]
    return found


def label_cloud_softly(cloud: PointCloud, bundle: ModelBundle) -> SoftLabels:
    """Label the points of a cloud, and return the class probabilities of the pool."""
    pooled = pooled_voxels(cloud, bundle)
    if pooled is None:
        return SoftLabels(*unlabelled(len(cloud)))
    probabilities, owner, region = pooled
    best, probability = decide(probabilities, next(iter(members_of(bundle).values())).arrays.get("groups"))
    weights = bundle.metadata.get(METADATA)
    if weights is not None and "rgb" in cloud:
        paved, natural = pair = ground_classes(bundle.classes)
        rows, terms = ground_terms(probabilities, best, pair, cloud["rgb"], owner, region)
        share = natural_share(terms, weights)
        both = probabilities[rows, paved] + probabilities[rows, natural]
        probabilities[rows, natural], probabilities[rows, paved] = both * share, both * (1.0 - share)
        best[rows] = np.where(share > 0.5, natural, paved)
    return labels_of_rows(best, probability, probabilities, owner)


class PooledVoxels(NamedTuple):
    """Class probabilities of each combination of the members' voxels or superpoints."""

    probabilities: NDArray[np.float64]  # Probabilities of the pool
    owner: NDArray[np.int32]  # Combination of each point, -1 for none
    region: NDArray[np.int32]  # Voxel or superpoint of the last member that each combination is in


def pooled_voxels(cloud: PointCloud, bundle: ModelBundle) -> PooledVoxels | None:
    """Return the class probabilities of the pool, before the ground is divided by colour."""
    members = members_of(bundle)
    tables: list[NDArray[np.float32]] = []
    rows: list[NDArray[np.int32]] = []  # of each table, per combination
    combination = np.zeros(len(cloud), np.int32)
    unused = {"rgb", "intensity"} - set(bundle.metadata.get("attributes", ()))
    plain = cloud.without_columns(unused & set(cloud.columns))
    for name, member in members.items():
        soft = label_softly(member, plain)
        if soft.probabilities is None or soft.owner is None:
            if len(cloud) and (soft.labels >= 0).any():
                raise DataError(f"model {bundle.slug!r}: member {name!r} gives no class probabilities")
            return None
        tables.append(_summed(soft.probabilities, bundle.metadata.get("merged", {}).get(name), len(bundle.classes)))
        owner = soft.owner.astype(np.int32, copy=False)
        if not rows:
            combination, rows = owner, [np.arange(len(tables[0]), dtype=np.int32)]
            continue
        before, own, combination = rank_pairs(combination, owner, len(rows[0]))
        rows = [*(earlier[before] for earlier in rows), own]
    if not (combination >= 0).any():
        return None
    pooled = np.zeros((len(rows[0]), len(bundle.classes)))
    for name, probabilities, own in zip(members, tables, rows, strict=True):
        pooled += (float(bundle.metadata["weights"][name]) * np.log(np.maximum(probabilities, FLOOR))).take(own, axis=0)
    pooled = np.exp(pooled - largest_of_rows(pooled))
    pooled /= pooled.sum(axis=1, keepdims=True)
    return PooledVoxels(pooled, combination, rows[-1])


def _summed(probabilities: NDArray[np.float32], table: Sequence[int] | None, n_classes: int) -> NDArray[np.float32]:
    """Return probabilities of the classes of a pool; `table` has the class that holds each class of a member."""
    if table is None:
        return probabilities
    if len(table) != probabilities.shape[1]:
        raise DataError(f"model {SLUG!r}: {len(table)} merged classes for {probabilities.shape[1]} of the member")
    return probabilities @ (np.array(table)[:, None] == np.arange(n_classes)).astype(np.float32)
