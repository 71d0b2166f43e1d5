"""Objects of a class found by their likeness to queries (Yu et al. 2016, IV-C)."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.detection import best_threshold, detect_by_thresholds
from mlsroad_pipeline.algorithms.exceptions import DataError
from mlsroad_pipeline.algorithms.object_detector_training import choose_queries
from mlsroad_pipeline.algorithms.validation import check_column
from mlsroad_pipeline.algorithms.visual_words.bags import inverse_document_frequency, similarity, weigh_words
from mlsroad_pipeline.algorithms.visual_words.queries import ClassQueries, DetectorParameters
from mlsroad_pipeline.algorithms.visual_words.sizes import SIZES, size_likeness, within_sizes
from mlsroad_pipeline.algorithms.visual_words.weights import assign_folds, held_out_scores, learn_weights, weigh

logger = logging.getLogger(__name__)

_DEFAULTS = DetectorParameters()


class VisualWordsDetector:
    """Detects objects whose bag of words, and size, are like those of queries.

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
    """

    def __init__(self, classes: Sequence[str], *, parameters: DetectorParameters = _DEFAULTS) -> None:
        self.classes = tuple(classes)
        self.parameters = parameters

    def fit(
        self, counts: csr_array, labels: ArrayLike, *, sizes: ArrayLike | None = None, scenes: ArrayLike | None = None
    ) -> VisualWordsDetector:
        """Choose queries and thresholds from training objects.

        With ``decision`` "nearest" queries are taken one by one, each time the object that raises the F-score on the
        training objects most, at the threshold that is best for it; no object is compared with itself. With "weighted"
        the threshold is the best one for the scores of held-out scenes; where all examples of a class are in one fold
        it is the border of the vote, 0.5. A class without training objects is warned of and never detected.

        Parameters
        ----------
        counts : csr_array of shape (n, v)
            Words of the training objects.
        labels : array-like of shape (n,), integer
            Class of each, an index into `classes`; -1 for all others.
        sizes : array-like of shape (n, 4), optional
            What `measure_sizes` gave; without, all objects are taken to be of one size.
        scenes : array-like of shape (n,), optional
            Scene of each; without, each object is held out by itself.

        Returns
        -------
        VisualWordsDetector
            The detector.

        Raises
        ------
        DataError
            If there is not one label, size or scene per object.
        """
        truth = np.asarray(labels)
        n = counts.shape[0]
        if truth.shape != (n,):
            raise DataError(f"{truth.shape} labels for {n} objects")
        large = _sizes(sizes, n)
        given = np.arange(n) if scenes is None else check_column(scenes, n, "scenes")
        self.inverse_frequency_ = inverse_document_frequency(counts)
        bags = weigh_words(counts, self.inverse_frequency_)
        filled = np.asarray(counts.sum(axis=1)).ravel()
        self.queries_: dict[str, ClassQueries] = {}
        self.f_scores_: dict[str, float] = {}
        self.examples_ = [_range(large[(truth == k) & (filled > 0)]) for k in range(len(self.classes))]
        fit = self._fit_weighted if self.parameters.decision == "weighted" else self._fit_nearest
        fit(bags, large, truth, filled, given)
        return self

    def _none(self, name: str, bags: csr_array) -> None:
        """Warn of a class without examples."""
        logger.warning("No training object is a %s: the model never detects one", name)
        nothing = np.zeros((0, len(SIZES)), np.float32)
        self.queries_[name] = ClassQueries(bags[np.zeros(0, np.int64)], nothing, np.zeros(0), 0.0, float("inf"))

    def _fit_nearest(
        self, bags: csr_array, sizes: NDArray[np.float32], truth: NDArray, filled: NDArray[np.float64], _: NDArray
    ) -> None:
        possible = self._possible(sizes)
        for number, name in enumerate(self.classes):
            mine = np.flatnonzero((truth == number) & (filled > 0))
            if len(mine) == 0:
                self._none(name, bags)
                continue
            order = mine[np.argsort(-filled[mine], kind="stable")][: self.parameters.candidates]
            alike = self._likeness(bags[order], sizes[order], bags, sizes) * possible
            most = self.parameters.max_queries
            chosen, threshold, self.f_scores_[name] = choose_queries(alike, order, truth == number, max_queries=most)
            rows = order[chosen]
            self.queries_[name] = ClassQueries(bags[rows], sizes[rows], np.zeros(0), 0.0, threshold)

    def _fit_weighted(
        self, bags: csr_array, sizes: NDArray[np.float32], truth: NDArray, filled: NDArray[np.float64], scenes: NDArray
    ) -> None:
        p = self.parameters
        rows = self._taking_part(sizes, truth, filled > 0)
        known, large = bags[rows], sizes[rows]
        alike = self._likeness(known, large, known, large)
        fold = assign_folds(scenes[rows], p.folds, p.seed)
        for number, name in enumerate(self.classes):
            mine = truth[rows] == number
            if not mine.any():
                self._none(name, bags)
                continue
            if mine.all():
                raise DataError(f"all training objects are a {name}: the weighted decision needs others too")
            found = learn_weights(alike, mine, p.penalty)
            scores = held_out_scores(alike, mine, fold, p.penalty)
            self.f_scores_[name], threshold = best_threshold(scores, mine)
            if len(np.unique(fold[mine])) == 1:
                threshold = 0.5
            self.queries_[name] = ClassQueries(
                known[found.chosen], large[found.chosen], found.values, found.offset, threshold
            )

    def _taking_part(self, sizes: NDArray[np.float32], truth: NDArray, filled: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the training objects that vote: all of wanted classes, and others of a size that these may have."""
        p = self.parameters
        others = np.flatnonzero(filled & (truth < 0))
        near = self._possible(sizes)[others]
        # Where all others are of another size they still have to stand against the classes.
        others = others[near] if near.any() else others
        if len(others) > p.max_others:
            others = np.random.default_rng(p.seed).permutation(others)[: p.max_others]
        return np.sort(np.concatenate([np.flatnonzero(filled & (truth >= 0)), others])).astype(np.int64)

    def _likeness(
        self, queries: csr_array, large: NDArray[np.float32], bags: csr_array, sizes: NDArray[np.float32]
    ) -> NDArray[np.float64]:
        """Return the likeness of every object to every query."""
        share = self.parameters.size_share
        alike = similarity(queries, bags)
        if share > 0:
            alike = (1.0 - share) * alike + share * size_likeness(large, sizes)
        return alike

    def _possible(self, sizes: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Tell which objects are of a size that some class may have."""
        margin = self.parameters.size_margin
        if margin == 0:
            return np.ones(len(sizes), np.bool_)
        found = [within_sizes(sizes, examples, margin) for examples in self.examples_]
        return np.asarray(np.any(found, axis=0))

    def score(self, counts: csr_array, sizes: ArrayLike | None = None) -> NDArray[np.float64]:
        """Compare objects with the queries.

        Parameters
        ----------
        counts : csr_array of shape (n, v)
            Words of the objects.
        sizes : array-like of shape (n, 4), optional
            What `measure_sizes` gave; left out where it was in `fit`.

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
        bags = weigh_words(counts, self.inverse_frequency_)
        large = _sizes(sizes, counts.shape[0])
        scores = np.zeros((counts.shape[0], len(self.classes)))
        rows = np.flatnonzero(self._possible(large) & (np.asarray(counts.sum(axis=1)).ravel() > 0))
        for number, found in enumerate(self.queries_.values()):
            alike = self._likeness(found.bags, found.sizes, bags[rows], large[rows])
            if len(found.weights):
                scores[rows, number] = weigh(alike, found.weights, found.offset)
            else:
                scores[rows, number] = alike.max(axis=0, initial=0.0)
        return scores

    def detect(
        self, counts: csr_array, sizes: ArrayLike | None = None
    ) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Detect objects.

        Parameters
        ----------
        counts : csr_array of shape (n, v)
            Words of the objects.
        sizes : array-like of shape (n, 4), optional
            What `measure_sizes` gave; left out where it was in `fit`.

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
        return detect_by_thresholds(self.score(counts, sizes), self.thresholds)

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
            "size_margin": np.array(p.size_margin),
        }
        for number, (found, examples) in enumerate(zip(self.queries_.values(), self.examples_, strict=True)):
            parts = {"data": found.bags.data, "indices": found.bags.indices, "indptr": found.bags.indptr}
            parts |= {"sizes": found.sizes, "weights": found.weights, "offset": np.array(found.offset)}
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
        parameters = DetectorParameters(
            size_share=float(arrays["size_share"]), size_margin=float(arrays["size_margin"])
        )
        detector = cls([str(name) for name in arrays["classes"]], parameters=parameters)
        detector.inverse_frequency_ = arrays["inverse_frequency"]
        detector.queries_, detector.examples_ = {}, []
        for number, name in enumerate(detector.classes):
            own = {
                part: arrays[f"queries.{number}.{part}"]
                for part in ("data", "indices", "indptr", "sizes", "weights", "offset", "threshold", "examples")
            }
            shape = (len(own["indptr"]) - 1, len(detector.inverse_frequency_))
            bags = csr_array((own["data"], own["indices"], own["indptr"]), shape=shape)
            detector.queries_[name] = ClassQueries(
                bags, own["sizes"], own["weights"], float(own["offset"]), float(own["threshold"])
            )
            detector.examples_.append(own["examples"])
        return detector


def _sizes(sizes: ArrayLike | None, n: int) -> NDArray[np.float32]:
    """Return sizes, or those of objects that are all alike."""
    found = np.ones((n, len(SIZES)), np.float32) if sizes is None else np.asarray(sizes, dtype=np.float32)
    if found.shape != (n, len(SIZES)):
        raise DataError(f"{n} objects need sizes of shape ({n}, {len(SIZES)}), got {found.shape}")
    return found


def _range(sizes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the least and the greatest of each size; no rows where there are no objects."""
    return np.stack([sizes.min(axis=0), sizes.max(axis=0)]) if len(sizes) else sizes
