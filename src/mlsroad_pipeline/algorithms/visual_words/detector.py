"""Objects of a class found by their likeness to queries (Yu et al. 2016, IV-C)."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.metrics.detection import precision_recall_curve
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
        for number, name in enumerate(self.classes):
            mine = np.flatnonzero((truth == number) & (filled > 0))
            if len(mine) == 0:
                logger.warning("No training object is a %s: the model never detects one", name)
                self.queries_[name] = ClassQueries(bags[mine], float("inf"))
                continue
            order = mine[np.argsort(-filled[mine], kind="stable")][: self.parameters.candidates]
            chosen, threshold = _choose(similarity(bags[order], bags), order, truth == number, self.parameters)
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
        found = self.score(counts)
        thresholds = np.array([q.threshold for q in self.queries_.values()])
        margin = found / np.maximum(thresholds, 1e-12)
        best = margin.argmax(axis=1)
        rows = np.arange(len(found))
        passed = found[rows, best] >= thresholds[best]
        labels = np.where(passed, best, -1).astype(np.int16)
        return labels, np.where(passed, found[rows, best], 0.0).astype(np.float32)

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


def _choose(
    likeness: NDArray[np.float64],
    candidates: NDArray[np.int64],
    truth: NDArray[np.bool_],
    parameters: DetectorParameters,
) -> tuple[list[int], float]:
    """Choose queries greedily; return them and the threshold that is best for all of them."""
    likeness = likeness.copy()
    likeness[np.arange(len(candidates)), candidates] = 0.0  # nothing is found by itself
    best = np.zeros(likeness.shape[1])
    chosen: list[int] = []
    reached, threshold = -1.0, float("inf")
    while len(chosen) < min(parameters.max_queries, len(candidates)):
        trials = [
            (-1.0, float("inf")) if k in chosen else _best_threshold(np.maximum(best, row), truth)
            for k, row in enumerate(likeness)
        ]
        k = int(np.argmax([value for value, _ in trials]))
        if trials[k][0] <= reached:
            break
        reached, threshold = trials[k]
        chosen.append(k)
        best = np.maximum(best, likeness[k])
    return chosen, threshold


def _best_threshold(scores: NDArray[np.float64], truth: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the best F-score, and the middle of the scores between which it is reached.

    A score of 0 is no likeness at all and never detected; where nothing scores, anything above 0 is.
    """
    some = scores > 0
    if not (some & truth).any():
        return 0.0, float(np.nextafter(0.0, 1.0))
    levels, precision, recall = precision_recall_curve(scores[some], truth[some], int(truth.sum()))
    with np.errstate(invalid="ignore"):
        f_score = np.where(precision + recall > 0, 2 * precision * recall / (precision + recall), 0.0)
    k = int(np.argmax(f_score))
    below = levels[k + 1] if k + 1 < len(levels) else 0.0
    return float(f_score[k]), float(0.5 * (levels[k] + below))
