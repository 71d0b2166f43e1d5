"""Queries of objects, and detection by similarity to them (Yu et al. 2016, section IV-C)."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column
from mlsroad_pipeline.algorithms.models.bundle import arrays_under
from mlsroad_pipeline.papers.shared.detection.thresholds import best_threshold, choose_queries, detect_by_thresholds
from mlsroad_pipeline.papers.yu2016.visual_words.appearance import (
    Appearance,
    appearance_of,
    inverse_document_frequency,
    size_range,
    weigh_words,
    within_any_sizes,
)
from mlsroad_pipeline.papers.yu2016.visual_words.queries import ClassQueries, DetectorParameters, HeldOut
from mlsroad_pipeline.papers.yu2016.visual_words.weights import (
    assign_folds,
    held_out_scores,
    learn_weights,
    train_committee,
    weigh,
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
    objects: TrainingObjects, wanted: NDArray[np.int64], others: NDArray[np.int64], parameters: DetectorParameters
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


_DEFAULTS = DetectorParameters()


class VisualWordsDetector:
    """Detector of objects whose bag of words, size and profile are similar to those of queries."""

    def __init__(self, classes: Sequence[str], *, parameters: DetectorParameters = _DEFAULTS) -> None:
        self.classes = tuple(classes)
        self.parameters = parameters

    def fit(
        self,
        counts: csr_array,
        labels: ArrayLike,
        *,
        sizes: ArrayLike | None = None,
        profiles: ArrayLike | None = None,
        scenes: ArrayLike | None = None,
        weights: ArrayLike | None = None,
    ) -> VisualWordsDetector:
        """Choose queries and thresholds from training objects.

        With ``decision`` "nearest" queries are selected greedily: each is the object that raises the F-score on the
        training objects most, at its best threshold; no object is compared with itself.
        """
        truth = np.asarray(labels)
        n = counts.shape[0]
        if truth.shape != (n,):
            raise DataError(f"{truth.shape} labels for {n} objects")
        of_scene = np.arange(n) if scenes is None else check_column(scenes, n, "scenes")
        self.inverse_frequency_ = inverse_document_frequency(counts)
        appearance = appearance_of(weigh_words(counts, self.inverse_frequency_), sizes, profiles)
        filled = np.asarray(counts.sum(axis=1)).ravel()
        self.size_ranges_ = [
            size_range(appearance.sizes[(truth == k) & (filled > 0)]) for k in range(len(self.classes))
        ]
        objects = TrainingObjects(
            appearance,
            labels=truth,
            n_words=filled,
            scenes=of_scene,
            weights=np.ones(n) if weights is None else check_column(weights, n, "weights"),
            possible=self.possible(appearance.sizes),
        )
        if self.parameters.decision == "weighted":
            self.queries_, self.f_scores_, self.held_out_ = fit_weighted(objects, self.classes, self.parameters)
        else:
            self.queries_, self.f_scores_ = fit_nearest(objects, self.classes, self.parameters)
        return self

    def possible(self, sizes: ArrayLike) -> NDArray[np.bool_]:
        """Return which objects have a size that a class may have; others are never detected."""
        return within_any_sizes(np.asarray(sizes, dtype=np.float32), self.size_ranges_, self.parameters.size_margin)

    def score(
        self, counts: csr_array, sizes: ArrayLike | None = None, profiles: ArrayLike | None = None
    ) -> NDArray[np.float64]:
        """Score objects by their similarity to the queries."""
        appearance = appearance_of(weigh_words(counts, self.inverse_frequency_), sizes, profiles)
        scores = np.zeros((counts.shape[0], len(self.classes)))
        rows = np.flatnonzero(self.possible(appearance.sizes) & (np.asarray(counts.sum(axis=1)).ravel() > 0))
        possible = appearance.select(rows)
        for number, queries in enumerate(self.queries_.values()):
            similarities = self.parameters.similarity(queries.appearance, possible)
            if len(queries.weights):
                scores[rows, number] = weigh(similarities, queries.weights, queries.offset)
            else:
                scores[rows, number] = similarities.max(axis=0, initial=0.0)
        return scores

    def detect(
        self, counts: csr_array, sizes: ArrayLike | None = None, profiles: ArrayLike | None = None
    ) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Detect objects."""
        return detect_by_thresholds(self.score(counts, sizes, profiles), self.thresholds)

    @property
    def thresholds(self) -> NDArray[np.float64]:
        """Lowest score at which an object is detected, one per class."""
        return np.array([queries.threshold for queries in self.queries_.values()])

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the trained state as plain arrays."""
        p = self.parameters
        arrays: dict[str, NDArray] = {
            "inverse_frequency": self.inverse_frequency_,
            "classes": np.array(self.classes),
            "size_share": np.array(p.size_share),
            "profile_share": np.array(p.profile_share),
            "size_margin": np.array(p.size_margin),
        }
        for number, (queries, ranges) in enumerate(zip(self.queries_.values(), self.size_ranges_, strict=True)):
            parts = {**queries.to_arrays(), "examples": ranges}
            arrays |= {f"queries.{number}.{name}": part for name, part in parts.items()}
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> VisualWordsDetector:
        """Rebuild a detector from its state."""
        size, profile, margin = (float(arrays[name]) for name in ("size_share", "profile_share", "size_margin"))
        parameters = DetectorParameters(size_share=size, profile_share=profile, size_margin=margin)
        detector = cls([str(name) for name in arrays["classes"]], parameters=parameters)
        detector.inverse_frequency_ = arrays["inverse_frequency"]
        detector.queries_, detector.size_ranges_ = {}, []
        for number, name in enumerate(detector.classes):
            own = arrays_under(arrays, f"queries.{number}.")
            detector.queries_[name] = ClassQueries.from_arrays(own, n_words=len(detector.inverse_frequency_))
            detector.size_ranges_.append(own["examples"])
        return detector
