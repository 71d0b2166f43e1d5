"""Detection of objects by their similarity to queries (Yu et al. 2016, section IV-C)."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column
from mlsroad_pipeline.algorithms.detection.thresholds import best_threshold, choose_queries, detect_by_thresholds
from mlsroad_pipeline.algorithms.visual_words.appearance import Appearance, appearance_of, appearance_similarity
from mlsroad_pipeline.algorithms.visual_words.bags import inverse_document_frequency, weigh_words
from mlsroad_pipeline.algorithms.visual_words.queries import ClassQueries, DetectorParameters, HeldOut
from mlsroad_pipeline.algorithms.visual_words.sizes import size_range, within_any_sizes
from mlsroad_pipeline.algorithms.visual_words.weights import (
    assign_folds,
    held_out_scores,
    learn_weights,
    train_committee,
    weigh,
)

logger = logging.getLogger(__name__)

_DEFAULTS = DetectorParameters()
_PARTS = ("data", "indices", "indptr", "sizes", "profiles", "weights", "offset", "threshold", "examples")


class VisualWordsDetector:
    """Detector of objects whose bag of words, size and profile are similar to those of queries.

    Parameters
    ----------
    classes : sequence of str
        Classes to detect.
    parameters : DetectorParameters
        Choice of queries and thresholds.

    Attributes
    ----------
    inverse_frequency_ : ndarray of float64, shape (v,)
        Second factor of equation 22 over the training objects.
    queries_ : dict of str to ClassQueries
        Queries and threshold of each class.
    examples_ : list of ndarray of float32, shape (e, 4)
        Least and greatest sizes of the examples of each class, to which `size_margin` is applied.
    f_scores_ : dict of str to float
        F-score of each class on the training objects. No object is compared with itself or, with "weighted", with
        others of its scene. Set by `fit` alone.
    held_out_ : HeldOut
        Held-out scores for threshold selection with "weighted". Set by `fit` alone.
    """

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
        training objects most, at its best threshold; no object is compared with itself. With "weighted" the vote is the
        mean of support vector machines, each trained without one fold of the scenes. The threshold is the best one for
        the held-out scores; it is 0.5 where no machine was trained on other examples of the class. A class without
        training objects is logged as a warning and never detected.

        Parameters
        ----------
        counts : csr_array of shape (n, v)
            Words of the training objects.
        labels : array-like of shape (n,), integer
            Class of each, an index in `classes`; -1 for all others.
        sizes : array-like of shape (n, 4), optional
            Sizes, see `measure_sizes`; by default all objects have the same size.
        profiles : array-like of shape (n, p), optional
            Profiles, see `measure_profiles`; by default all objects have the same profile.
        scenes : array-like of shape (n,), optional
            Scene of each; by default each object is a scene of its own.
        weights : array-like of shape (n,), optional
            Weight of each object in threshold selection, see `training_weights`; 1 by default.

        Returns
        -------
        VisualWordsDetector
            The detector.

        Raises
        ------
        DataError
            If there is not one label, size, profile, scene or weight per object.
        """
        truth = np.asarray(labels)
        n = counts.shape[0]
        if truth.shape != (n,):
            raise DataError(f"{truth.shape} labels for {n} objects")
        of_scene = np.arange(n) if scenes is None else check_column(scenes, n, "scenes")
        self.inverse_frequency_ = inverse_document_frequency(counts)
        appearance = appearance_of(weigh_words(counts, self.inverse_frequency_), sizes, profiles)
        filled = np.asarray(counts.sum(axis=1)).ravel()
        self.queries_: dict[str, ClassQueries] = {}
        self.f_scores_: dict[str, float] = {}
        self.examples_ = [size_range(appearance.sizes[(truth == k) & (filled > 0)]) for k in range(len(self.classes))]
        fit = self._fit_weighted if self.parameters.decision == "weighted" else self._fit_nearest
        fit(appearance, truth, filled, of_scene, np.ones(n) if weights is None else check_column(weights, n, "weights"))
        return self

    def _none(self, name: str, appearance: Appearance) -> None:
        """Log a warning for a class without examples, and store no queries."""
        logger.warning("No training object is a %s: the model never detects one", name)
        nothing = appearance.select(np.zeros(0, np.int64))
        self.queries_[name] = ClassQueries(nothing, np.zeros(0), 0.0, float("inf"))

    def _fit_nearest(
        self,
        appearance: Appearance,
        truth: NDArray,
        filled: NDArray[np.float64],
        _: NDArray,
        weights: NDArray[np.float64],
    ) -> None:
        """Select few queries of each class greedily."""
        possible = self.possible(appearance.sizes)
        for number, name in enumerate(self.classes):
            mine = np.flatnonzero((truth == number) & (filled > 0))
            if len(mine) == 0:
                self._none(name, appearance)
                continue
            order = mine[np.argsort(-filled[mine], kind="stable")][: self.parameters.candidates]
            alike = self._similarity(appearance.select(order), appearance) * possible
            most = self.parameters.max_queries
            chosen = choose_queries(alike, order, truth == number, max_queries=most)[0]
            alike[np.arange(len(order)), order] = 0.0  # no object is compared with itself
            nearest = alike[chosen].max(axis=0, initial=0.0)
            self.f_scores_[name], level = best_threshold(nearest, truth == number, weights)
            self.queries_[name] = ClassQueries(appearance.select(order[chosen]), np.zeros(0), 0.0, level)

    def _fit_weighted(
        self,
        appearance: Appearance,
        truth: NDArray,
        filled: NDArray[np.float64],
        scenes: NDArray,
        weights: NDArray[np.float64],
    ) -> None:
        """Train the weighted vote of each class, and choose thresholds on held-out scores."""
        p = self.parameters
        wanted, others = self._candidates(appearance.sizes, truth, filled > 0)
        every = np.sort(np.concatenate([wanted, others]))
        rows = np.sort(np.concatenate([wanted, self._counterexamples(appearance, wanted, others)]))
        known, kinds = appearance.select(rows), truth[rows]
        alike = self._similarity(known, known)
        folds = np.stack([assign_folds(scenes[every], p.folds, p.seed + r) for r in range(p.rounds)])
        own = folds[:, np.searchsorted(every, rows)]
        committees = [train_committee(alike, kinds == k, own, penalty=p.penalty) for k in range(len(self.classes))]
        scores = held_out_scores(
            committees, lambda here: self._similarity(known, appearance.select(every[here])), folds
        )
        self.held_out_ = HeldOut(scores, truth[every], scenes[every])
        for number, name in enumerate(self.classes):
            mine = kinds == number
            if not mine.any():
                self._none(name, appearance)
                continue
            if mine.all():
                raise DataError(f"all training objects are a {name}: the weighted decision needs others too")
            vote = committees[number].mean() or learn_weights(alike, mine, p.penalty)
            self.f_scores_[name], threshold = best_threshold(scores[:, number], truth[every] == number, weights[every])
            if not (scores[truth[every] == number, number] > 0).any():
                threshold = 0.5
            self.queries_[name] = ClassQueries(known.select(vote.chosen), vote.values, vote.offset, threshold)

    def _candidates(
        self, sizes: NDArray[np.float32], truth: NDArray, filled: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the objects of wanted classes, and other objects of possible sizes."""
        others = np.flatnonzero(filled & (truth < 0))
        near = self.possible(sizes)[others]
        # Where no other object has a possible size, all others are used.
        return np.flatnonzero(filled & (truth >= 0)), others[near] if near.any() else others

    def _counterexamples(
        self, appearance: Appearance, wanted: NDArray[np.int64], others: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Return the counterexamples: half are the most similar to an example, half are drawn from the rest."""
        most = self.parameters.max_others
        if len(others) <= most:
            return others
        alike = self._similarity(appearance.select(wanted), appearance.select(others)).max(axis=0, initial=0.0)
        order = np.argsort(-alike, kind="stable")
        near, rest = order[: (most + 1) // 2], order[(most + 1) // 2 :]
        drawn = np.random.default_rng(self.parameters.seed).permutation(rest)[: most // 2]
        return others[np.concatenate([near, drawn])]

    def _similarity(self, queries: Appearance, objects: Appearance) -> NDArray[np.float64]:
        """Return the similarity of every object to every query."""
        p = self.parameters
        return appearance_similarity(queries, objects, size_share=p.size_share, profile_share=p.profile_share)

    def possible(self, sizes: ArrayLike) -> NDArray[np.bool_]:
        """Return which objects have a size that a class may have; others are never detected.

        Parameters
        ----------
        sizes : array-like of shape (n, 4)
            Sizes, see `measure_sizes`.

        Returns
        -------
        ndarray of bool, shape (n,)
            One flag per object.
        """
        return within_any_sizes(np.asarray(sizes, dtype=np.float32), self.examples_, self.parameters.size_margin)

    def score(
        self, counts: csr_array, sizes: ArrayLike | None = None, profiles: ArrayLike | None = None
    ) -> NDArray[np.float64]:
        """Score objects by their similarity to the queries.

        Parameters
        ----------
        counts : csr_array of shape (n, v)
            Words of the objects.
        sizes : array-like of shape (n, 4), optional
            Sizes, see `measure_sizes`; required if `fit` had them.
        profiles : array-like of shape (n, p), optional
            Profiles, see `measure_profiles`; required if `fit` had them.

        Returns
        -------
        ndarray of float64, shape (n, classes)
            Score of each class, in [0, 1]: similarity to the most similar query, or the weighted vote of all queries. 0
            for objects without words or of a size that no class has.

        Raises
        ------
        DataError
            If the objects have another vocabulary.
        """
        appearance = appearance_of(weigh_words(counts, self.inverse_frequency_), sizes, profiles)
        scores = np.zeros((counts.shape[0], len(self.classes)))
        rows = np.flatnonzero(self.possible(appearance.sizes) & (np.asarray(counts.sum(axis=1)).ravel() > 0))
        possible = appearance.select(rows)
        for number, queries in enumerate(self.queries_.values()):
            alike = self._similarity(queries.appearance, possible)
            if len(queries.weights):
                scores[rows, number] = weigh(alike, queries.weights, queries.offset)
            else:
                scores[rows, number] = alike.max(axis=0, initial=0.0)
        return scores

    def detect(
        self, counts: csr_array, sizes: ArrayLike | None = None, profiles: ArrayLike | None = None
    ) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Detect objects.

        Parameters
        ----------
        counts : csr_array of shape (n, v)
            Words of the objects.
        sizes : array-like of shape (n, 4), optional
            Sizes, see `measure_sizes`; required if `fit` had them.
        profiles : array-like of shape (n, p), optional
            Profiles, see `measure_profiles`; required if `fit` had them.

        Returns
        -------
        labels : ndarray of int16, shape (n,)
            Class whose threshold the score exceeds by the largest factor; -1 for none.
        scores : ndarray of float32, shape (n,)
            Score of that class; 0 for none.

        Raises
        ------
        DataError
            If the objects have another vocabulary.
        """
        return detect_by_thresholds(self.score(counts, sizes, profiles), self.thresholds)

    @property
    def thresholds(self) -> NDArray[np.float64]:
        """Lowest score at which an object is detected, one per class."""
        return np.array([queries.threshold for queries in self.queries_.values()])

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the trained state as plain arrays.

        Returns
        -------
        dict of str to ndarray
            For `from_arrays`.
        """
        p = self.parameters
        arrays: dict[str, NDArray] = {
            "inverse_frequency": self.inverse_frequency_,
            "classes": np.array(self.classes),
            "size_share": np.array(p.size_share),
            "profile_share": np.array(p.profile_share),
            "size_margin": np.array(p.size_margin),
        }
        for number, (queries, examples) in enumerate(zip(self.queries_.values(), self.examples_, strict=True)):
            bags = queries.appearance.bags
            parts = {
                "data": bags.data,
                "indices": bags.indices,
                "indptr": bags.indptr,
                "sizes": queries.appearance.sizes,
                "profiles": queries.appearance.profiles,
                "weights": queries.weights,
                "offset": np.array(queries.offset),
                "threshold": np.array(queries.threshold),
                "examples": examples,
            }
            arrays |= {f"queries.{number}.{name}": part for name, part in parts.items()}
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> VisualWordsDetector:
        """Rebuild a detector from its state.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            Result of `to_arrays`.

        Returns
        -------
        VisualWordsDetector
            The same detector.
        """
        size, profile, margin = (float(arrays[name]) for name in ("size_share", "profile_share", "size_margin"))
        parameters = DetectorParameters(size_share=size, profile_share=profile, size_margin=margin)
        detector = cls([str(name) for name in arrays["classes"]], parameters=parameters)
        detector.inverse_frequency_ = arrays["inverse_frequency"]
        detector.queries_, detector.examples_ = {}, []
        for number, name in enumerate(detector.classes):
            own = {part: arrays[f"queries.{number}.{part}"] for part in _PARTS}
            shape = (len(own["indptr"]) - 1, len(detector.inverse_frequency_))
            bags = csr_array((own["data"], own["indices"], own["indptr"]), shape=shape)
            appearance = Appearance(bags, own["sizes"], own["profiles"])
            detector.queries_[name] = ClassQueries(
                appearance, own["weights"], float(own["offset"]), float(own["threshold"])
            )
            detector.examples_.append(own["examples"])
        return detector
