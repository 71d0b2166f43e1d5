"""Objects of a class found by their likeness to queries (Yu et al. 2016, IV-C)."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.detection import detect_by_thresholds
from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.object_detector_training import choose_queries
from mlsroad_pipeline.algorithms.visual_words.bags import inverse_document_frequency, similarity, weigh_words

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class DetectorParameters:
    """How queries and thresholds are chosen.

    Parameters
    ----------
    max_queries : int, default 12
        The most queries of a class. The paper names none; one complete car does not stand for every make and every
        side that it is seen from.
    candidates : int, default 200
        Training objects of a class that may become queries: those with the most words.

    Raises
    ------
    ParameterError
        If a number is below 1.
    """

    max_queries: int = 12
    candidates: int = 200

    def __post_init__(self) -> None:
        for name in ("max_queries", "candidates"):
            if getattr(self, name) < 1:
                raise ParameterError(f"{name} must be at least 1, got {getattr(self, name)!r}")


@dataclass(frozen=True)
class ClassQueries:
    """What one class is looked for with.

    Attributes
    ----------
    bags : csr_array of shape (q, v)
        Bags of the queries.
    threshold : float
        Likeness from which an object is detected.
    """

    bags: csr_array
    threshold: float


class VisualWordsDetector:
    """Detects objects whose bag of words is like that of a query.

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
    f_scores_ : dict of str to float
        F-score of each class on the training objects, none compared with itself; after `fit` alone.
    """

    def __init__(self, classes: Sequence[str], *, parameters: DetectorParameters = DetectorParameters()) -> None:
        self.classes = tuple(classes)
        self.parameters = parameters

    def fit(self, counts: csr_array, labels: ArrayLike) -> VisualWordsDetector:
        """Choose queries and thresholds from training objects.

        For each class queries are taken one by one, each time the object that raises the F-score on the training
        objects most, at the threshold that is best for it; no object is compared with itself. It ends when none raises
        it any more. A class without training objects is warned of and never detected.

        Parameters
        ----------
        counts : csr_array of shape (n, v)
            Words of the training objects.
        labels : array-like of shape (n,), integer
            Class of each, an index into `classes`; -1 for all others.

        Returns
        -------
        VisualWordsDetector
            The detector.

        Raises
        ------
        DataError
            If there is not one label per object.
        """
        truth = np.asarray(labels)
        if truth.shape != (counts.shape[0],):
            raise DataError(f"{truth.shape} labels for {counts.shape[0]} objects")
        self.inverse_frequency_ = inverse_document_frequency(counts)
        bags = weigh_words(counts, self.inverse_frequency_)
        filled = np.asarray(counts.sum(axis=1)).ravel()
        self.queries_: dict[str, ClassQueries] = {}
        self.f_scores_: dict[str, float] = {}
        for number, name in enumerate(self.classes):
            mine = np.flatnonzero((truth == number) & (filled > 0))
            if len(mine) == 0:
                logger.warning("No training object is a %s: the model never detects one", name)
                self.queries_[name] = ClassQueries(bags[mine], float("inf"))
                continue
            order = mine[np.argsort(-filled[mine], kind="stable")][: self.parameters.candidates]
            alike = similarity(bags[order], bags)
            most = self.parameters.max_queries
            chosen, threshold, self.f_scores_[name] = choose_queries(alike, order, truth == number, max_queries=most)
            self.queries_[name] = ClassQueries(bags[order[chosen]], threshold)
        return self

    def score(self, counts: csr_array) -> NDArray[np.float64]:
        """Compare objects with the queries.

        Parameters
        ----------
        counts : csr_array of shape (n, v)
            Words of the objects.

        Returns
        -------
        ndarray of float64, shape (n, classes)
            Likeness to the most similar query of each class, in [0, 1].

        Raises
        ------
        DataError
            If the objects have another vocabulary.
        """
        bags = weigh_words(counts, self.inverse_frequency_)
        return np.column_stack([similarity(q.bags, bags).max(axis=0, initial=0.0) for q in self.queries_.values()])

    def detect(self, counts: csr_array) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Detect objects.

        Parameters
        ----------
        counts : csr_array of shape (n, v)
            Words of the objects.

        Returns
        -------
        labels : ndarray of int16, shape (n,)
            The class whose threshold the object passes; of several the one that it passes by the largest factor; -1
            for none.
        scores : ndarray of float32, shape (n,)
            Likeness to the nearest query of that class; 0 for none.

        Raises
        ------
        DataError
            If the objects have another vocabulary.
        """
        return detect_by_thresholds(self.score(counts), self.thresholds)

    @property
    def thresholds(self) -> NDArray[np.float64]:
        """Likeness from which an object is detected, one per class."""
        return np.array([found.threshold for found in self.queries_.values()])

    def to_arrays(self) -> dict[str, NDArray]:
        """Return what was learned as plain arrays.

        Returns
        -------
        dict of str to ndarray
            For `from_arrays`.
        """
        arrays: dict[str, NDArray] = {"inverse_frequency": self.inverse_frequency_, "classes": np.array(self.classes)}
        for number, found in enumerate(self.queries_.values()):
            parts = {"data": found.bags.data, "indices": found.bags.indices, "indptr": found.bags.indptr}
            arrays |= {f"queries.{number}.{name}": part for name, part in parts.items()}
            arrays[f"queries.{number}.threshold"] = np.array(found.threshold)
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
        detector = cls([str(name) for name in arrays["classes"]])
        detector.inverse_frequency_ = arrays["inverse_frequency"]
        detector.queries_ = {}
        for number, name in enumerate(detector.classes):
            data, indices, indptr = (arrays[f"queries.{number}.{part}"] for part in ("data", "indices", "indptr"))
            bags = csr_array((data, indices, indptr), shape=(len(indptr) - 1, len(detector.inverse_frequency_)))
            detector.queries_[name] = ClassQueries(bags, float(arrays[f"queries.{number}.threshold"]))
        return detector
