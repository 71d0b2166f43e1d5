"""Fitting of queries and thresholds to training objects (Yu et al. 2016, section IV-C)."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.papers.shared.detection.thresholds import best_threshold, choose_queries
from mlsroad_pipeline.papers.yu2016.visual_words.appearance import Appearance
from mlsroad_pipeline.papers.yu2016.visual_words.queries import ClassQueries, DetectorParameters, HeldOut
from mlsroad_pipeline.papers.yu2016.visual_words.weights import (
    assign_folds,
    held_out_scores,
    learn_weights,
    train_committee,
)

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class TrainingObjects:
    """Objects that queries and thresholds are fitted to."""

    appearance: Appearance  # Bags, sizes and profiles of n objects
    labels: NDArray[np.integer]  # Class of each, an index in the classes; -1 for all others
    n_words: NDArray[np.float64]  # Number of words of each; objects without words are not used
    scenes: NDArray  # Scene of each
    weights: NDArray[np.float64]  # Weight of each in threshold selection
    possible: NDArray[np.bool_]  # Whether each has a size that a class may have


def fit_nearest(
    objects: TrainingObjects, classes: Sequence[str], parameters: DetectorParameters
) -> tuple[dict[str, ClassQueries], dict[str, float]]:
    """Select few queries of each class greedily, for the decision "nearest"."""
    queries: dict[str, ClassQueries] = {}
    f_scores: dict[str, float] = {}
    for number, name in enumerate(classes):
        mine = np.flatnonzero((objects.labels == number) & (objects.n_words > 0))
        if len(mine) == 0:
            queries[name] = _no_queries(name, objects.appearance)
            continue
        order = mine[np.argsort(-objects.n_words[mine], kind="stable")][: parameters.candidates]
        similarities = parameters.similarity(objects.appearance.select(order), objects.appearance) * objects.possible
        most = parameters.max_queries
        chosen = choose_queries(similarities, order, objects.labels == number, max_queries=most)[0]
        similarities[np.arange(len(order)), order] = 0.0  # no object is compared with itself
        nearest = similarities[chosen].max(axis=0, initial=0.0)
        f_scores[name], level = best_threshold(nearest, objects.labels == number, objects.weights)
        queries[name] = ClassQueries(objects.appearance.select(order[chosen]), np.zeros(0), 0.0, level)
    return queries, f_scores


def fit_weighted(
    objects: TrainingObjects, classes: Sequence[str], parameters: DetectorParameters
) -> tuple[dict[str, ClassQueries], dict[str, float], HeldOut]:
    """Train the weighted vote of each class, and choose thresholds on held-out scores, for the decision "weighted"."""
    p = parameters
    wanted, others = _candidates(objects)
    every = np.sort(np.concatenate([wanted, others]))
    rows = np.sort(np.concatenate([wanted, _counterexamples(objects, wanted, others, p)]))
    known, kinds, truth = objects.appearance.select(rows), objects.labels[rows], objects.labels[every]
    similarities = p.similarity(known, known)
    folds = np.stack([assign_folds(objects.scenes[every], p.folds, p.seed + r) for r in range(p.rounds)])
    own = folds[:, np.searchsorted(every, rows)]
    committees = [train_committee(similarities, kinds == k, own, penalty=p.penalty) for k in range(len(classes))]
    scores = held_out_scores(
        committees, lambda here: p.similarity(known, objects.appearance.select(every[here])), folds
    )
    queries: dict[str, ClassQueries] = {}
    f_scores: dict[str, float] = {}
    for number, name in enumerate(classes):
        mine = kinds == number
        if not mine.any():
            queries[name] = _no_queries(name, objects.appearance)
            continue
        if mine.all():
            raise DataError(f"all training objects are a {name}: the weighted decision needs others too")
        vote = committees[number].mean() or learn_weights(similarities, mine, p.penalty)
        f_scores[name], threshold = best_threshold(scores[:, number], truth == number, objects.weights[every])
        if not (scores[truth == number, number] > 0).any():
            threshold = 0.5
        queries[name] = ClassQueries(known.select(vote.chosen), vote.values, vote.offset, threshold)
    return queries, f_scores, HeldOut(scores, truth, objects.scenes[every])


def _no_queries(name: str, appearance: Appearance) -> ClassQueries:
    """Log a warning for a class without training objects, and return no queries."""
    logger.warning("No training object is a %s: the model never detects one", name)
    return ClassQueries(appearance.select(np.zeros(0, np.int64)), np.zeros(0), 0.0, float("inf"))


def _candidates(objects: TrainingObjects) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the objects of wanted classes, and other objects of possible sizes."""
    filled = objects.n_words > 0
    others = np.flatnonzero(filled & (objects.labels < 0))
    near = objects.possible[others]
    # Where no other object has a possible size, all others are used.
    return np.flatnonzero(filled & (objects.labels >= 0)), others[near] if near.any() else others


def _counterexamples(
    objects: TrainingObjects,
    wanted: NDArray[np.int64],
    others: NDArray[np.int64],
    parameters: DetectorParameters,
) -> NDArray[np.int64]:
    """Return the counterexamples: half are the most similar to an example, half are drawn from the rest."""
    most = parameters.max_others
    if len(others) <= most:
        return others
    examples, rest_of = objects.appearance.select(wanted), objects.appearance.select(others)
    similarities = parameters.similarity(examples, rest_of).max(axis=0, initial=0.0)
    order = np.argsort(-similarities, kind="stable")
    near, rest = order[: (most + 1) // 2], order[(most + 1) // 2 :]
    drawn = np.random.default_rng(parameters.seed).permutation(rest)[: most // 2]
    return others[np.concatenate([near, drawn])]
