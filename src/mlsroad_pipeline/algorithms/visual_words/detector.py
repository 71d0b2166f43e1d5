"""Objects of a class found by their likeness to queries (Yu et al. 2016, IV-C)."""

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
from mlsroad_pipeline.algorithms.visual_words.appearance import Appearance, appearance_of, likeness
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
    """Detects objects whose bag of words, size and profile are like those of queries.

    Parameters
    ----------
    classes : sequence of str
        Classes that are looked for.
    parameters : DetectorParameters
        How queries and thresholds are chosen.

    Attributes
    ----------
    inverse_frequency_ : ndarray of float64, shape (v,)
        Second factor of equation 22 over the training objects.
    queries_ : dict of str to ClassQueries
        Queries and threshold of each class.
    examples_ : list of ndarray of float32, shape (e, 4)
        Least and greatest sizes of the examples of each class, which `size_margin` is applied to.
    f_scores_ : dict of str to float
        F-score of each class on the training objects, none compared with itself or, with "weighted", its scene's
        others; after `fit` alone.
    held_out_ : HeldOut
        What thresholds were chosen by with "weighted"; after `fit` alone.
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

        With ``decision`` "nearest" queries are taken one by one, each time the object that raises the F-score on the
        training objects most, at the threshold that is best for it; no object is compared with itself. With "weighted"
        the vote is the mean of machines that each learned without one fold of the scenes, and the threshold is the best
        one for the scores by those that have not seen the object's; where no machine has seen other examples of the
        class it is the border of the vote, 0.5. A class without training objects is warned of and never detected.

        Parameters
        ----------
        counts : csr_array of shape (n, v)
            Words of the training objects.
        labels : array-like of shape (n,), integer
            Class of each, an index into `classes`; -1 for all others.
        sizes : array-like of shape (n, 4), optional
            What `measure_sizes` gave; without, all objects are taken to be of one size.
        profiles : array-like of shape (n, p), optional
            What `measure_profiles` gave; without, all objects are taken to have one.
        scenes : array-like of shape (n,), optional
            Scene of each; without, each object is held out by itself.
        weights : array-like of shape (n,), optional
            How often each object counts when thresholds are chosen, see `training_weights`; once by default.

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
        given = np.arange(n) if scenes is None else check_column(scenes, n, "scenes")
        self.inverse_frequency_ = inverse_document_frequency(counts)
        looks = appearance_of(weigh_words(counts, self.inverse_frequency_), sizes, profiles)
        filled = np.asarray(counts.sum(axis=1)).ravel()
        self.queries_: dict[str, ClassQueries] = {}
        self.f_scores_: dict[str, float] = {}
        self.examples_ = [size_range(looks.sizes[(truth == k) & (filled > 0)]) for k in range(len(self.classes))]
        fit = self._fit_weighted if self.parameters.decision == "weighted" else self._fit_nearest
        fit(looks, truth, filled, given, np.ones(n) if weights is None else check_column(weights, n, "weights"))
        return self

    def _none(self, name: str, looks: Appearance) -> None:
        """Warn of a class without examples."""
        logger.warning("No training object is a %s: the model never detects one", name)
        nothing = looks.select(np.zeros(0, np.int64))
        self.queries_[name] = ClassQueries(nothing, np.zeros(0), 0.0, float("inf"))

    def _fit_nearest(
        self, looks: Appearance, truth: NDArray, filled: NDArray[np.float64], _: NDArray, weights: NDArray[np.float64]
    ) -> None:
        possible = self.possible(looks.sizes)
        for number, name in enumerate(self.classes):
            mine = np.flatnonzero((truth == number) & (filled > 0))
            if len(mine) == 0:
                self._none(name, looks)
                continue
            order = mine[np.argsort(-filled[mine], kind="stable")][: self.parameters.candidates]
            alike = self._likeness(looks.select(order), looks) * possible
            most = self.parameters.max_queries
            chosen = choose_queries(alike, order, truth == number, max_queries=most)[0]
            alike[np.arange(len(order)), order] = 0.0  # nothing is found by itself
            nearest = alike[chosen].max(axis=0, initial=0.0)
            self.f_scores_[name], level = best_threshold(nearest, truth == number, weights)
            self.queries_[name] = ClassQueries(looks.select(order[chosen]), np.zeros(0), 0.0, level)

    def _fit_weighted(
        self,
        looks: Appearance,
        truth: NDArray,
        filled: NDArray[np.float64],
        scenes: NDArray,
        weights: NDArray[np.float64],
    ) -> None:
        p = self.parameters
        wanted, others = self._candidates(looks.sizes, truth, filled > 0)
        every = np.sort(np.concatenate([wanted, others]))
        rows = np.sort(np.concatenate([wanted, self._counterexamples(looks, wanted, others)]))
        known, kinds = looks.select(rows), truth[rows]
        alike = self._likeness(known, known)
        folds = np.stack([assign_folds(scenes[every], p.folds, p.seed + r) for r in range(p.rounds)])
        own = folds[:, np.searchsorted(every, rows)]
        committees = [train_committee(alike, kinds == k, own, penalty=p.penalty) for k in range(len(self.classes))]
        scores = held_out_scores(committees, lambda here: self._likeness(known, looks.select(every[here])), folds)
        self.held_out_ = HeldOut(scores, truth[every], scenes[every])
        for number, name in enumerate(self.classes):
            mine = kinds == number
            if not mine.any():
                self._none(name, looks)
                continue
            if mine.all():
                raise DataError(f"all training objects are a {name}: the weighted decision needs others too")
            found = committees[number].mean() or learn_weights(alike, mine, p.penalty)
            self.f_scores_[name], threshold = best_threshold(scores[:, number], truth[every] == number, weights[every])
            if not (scores[truth[every] == number, number] > 0).any():
                threshold = 0.5
            self.queries_[name] = ClassQueries(known.select(found.chosen), found.values, found.offset, threshold)

    def _candidates(
        self, sizes: NDArray[np.float32], truth: NDArray, filled: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the objects of wanted classes, and others of a size that these may have."""
        others = np.flatnonzero(filled & (truth < 0))
        near = self.possible(sizes)[others]
        # Where all others are of another size they still have to stand against the classes.
        return np.flatnonzero(filled & (truth >= 0)), others[near] if near.any() else others

    def _counterexamples(
        self, looks: Appearance, wanted: NDArray[np.int64], others: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Return the others that vote: half of them the most like an example, half drawn from the rest."""
        most = self.parameters.max_others
        if len(others) <= most:
            return others
        alike = self._likeness(looks.select(wanted), looks.select(others)).max(axis=0, initial=0.0)
        order = np.argsort(-alike, kind="stable")
        near, rest = order[: (most + 1) // 2], order[(most + 1) // 2 :]
        drawn = np.random.default_rng(self.parameters.seed).permutation(rest)[: most // 2]
        return others[np.concatenate([near, drawn])]

    def _likeness(self, queries: Appearance, objects: Appearance) -> NDArray[np.float64]:
        """Return the likeness of every object to every query."""
        p = self.parameters
        return likeness(queries, objects, size_share=p.size_share, profile_share=p.profile_share)

    def possible(self, sizes: ArrayLike) -> NDArray[np.bool_]:
        """Tell which objects are of a size that some class may have; no others are ever detected.

        Parameters
        ----------
        sizes : array-like of shape (n, 4)
            What `measure_sizes` gave.

        Returns
        -------
        ndarray of bool, shape (n,)
            One flag per object.
        """
        return within_any_sizes(np.asarray(sizes, dtype=np.float32), self.examples_, self.parameters.size_margin)

    def score(
        self, counts: csr_array, sizes: ArrayLike | None = None, profiles: ArrayLike | None = None
    ) -> NDArray[np.float64]:
        """Compare objects with the queries.

        Parameters
        ----------
        counts : csr_array of shape (n, v)
            Words of the objects.
        sizes : array-like of shape (n, 4), optional
            What `measure_sizes` gave; left out where it was in `fit`.
        profiles : array-like of shape (n, p), optional
            What `measure_profiles` gave; left out where it was in `fit`.

        Returns
        -------
        ndarray of float64, shape (n, classes)
            Score of each class, in [0, 1]: likeness to its most similar query, or the vote of all. 0 for objects
            without words or of a size that no class has.

        Raises
        ------
        DataError
            If the objects have another vocabulary.
        """
        looks = appearance_of(weigh_words(counts, self.inverse_frequency_), sizes, profiles)
        scores = np.zeros((counts.shape[0], len(self.classes)))
        rows = np.flatnonzero(self.possible(looks.sizes) & (np.asarray(counts.sum(axis=1)).ravel() > 0))
        looked_at = looks.select(rows)
        for number, found in enumerate(self.queries_.values()):
            alike = self._likeness(found.looks, looked_at)
            if len(found.weights):
                scores[rows, number] = weigh(alike, found.weights, found.offset)
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
            What `measure_sizes` gave; left out where it was in `fit`.
        profiles : array-like of shape (n, p), optional
            What `measure_profiles` gave; left out where it was in `fit`.

        Returns
        -------
        labels : ndarray of int16, shape (n,)
            The class whose threshold the object passes; of several the one that it passes by the largest factor; -1
            for none.
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
        """Score from which an object is detected, one per class."""
        return np.array([found.threshold for found in self.queries_.values()])

    def to_arrays(self) -> dict[str, NDArray]:
        """Return what was learned as plain arrays.

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
        for number, (found, examples) in enumerate(zip(self.queries_.values(), self.examples_, strict=True)):
            bags = found.looks.bags
            parts = {"data": bags.data, "indices": bags.indices, "indptr": bags.indptr}
            parts |= {
                "sizes": found.looks.sizes,
                "profiles": found.looks.profiles,
                "weights": found.weights,
                "offset": np.array(found.offset),
            }
            parts |= {"threshold": np.array(found.threshold), "examples": examples}
            arrays |= {f"queries.{number}.{name}": part for name, part in parts.items()}
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> VisualWordsDetector:
        """Build a detector from what `to_arrays` gave.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            The arrays.

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
            looks = Appearance(bags, own["sizes"], own["profiles"])
            detector.queries_[name] = ClassQueries(looks, own["weights"], float(own["offset"]), float(own["threshold"]))
            detector.examples_.append(own["examples"])
        return detector
