"""Detection of objects by their similarity to queries (Yu et al. 2016, section IV-C)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.validation import check_column
from mlsroad_pipeline.algorithms.models.bundle import arrays_under
from mlsroad_pipeline.papers.shared.detection.thresholds import detect_by_thresholds
from mlsroad_pipeline.papers.yu2016.visual_words.appearance import appearance_of
from mlsroad_pipeline.papers.yu2016.visual_words.bags import inverse_document_frequency, weigh_words
from mlsroad_pipeline.papers.yu2016.visual_words.queries import ClassQueries, DetectorParameters
from mlsroad_pipeline.papers.yu2016.visual_words.query_fitting import TrainingObjects, fit_nearest, fit_weighted
from mlsroad_pipeline.papers.yu2016.visual_words.sizes import size_range, within_any_sizes
from mlsroad_pipeline.papers.yu2016.visual_words.weights import weigh

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
