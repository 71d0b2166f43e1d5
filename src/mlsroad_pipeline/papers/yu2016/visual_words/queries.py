"""Parameters of the choice of queries and thresholds, and queries of a class (Yu et al. 2016, section IV-C)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.papers.yu2016.visual_words.appearance import Appearance, appearance_similarity


@dataclass(frozen=True)
class DetectorParameters:
    """Parameters of similarity, queries and thresholds."""

    # With "nearest" an object's score is its similarity to the most similar of a few queries of the class, as in the
    # paper. With "weighted" all training objects, including those of no wanted class, may be queries, and the score is
    # their weighted vote: a support vector machine whose kernel is the similarity.
    decision: Literal["weighted", "nearest"] = "weighted"
    # Weight of the size in the similarity of two objects, 0 to 1 (yu2016: 0). Bags contain shares of words, which do
    # not depend on the size of an object.
    size_share: float = 0.25
    # Weight of the profile in the similarity, 0 to 1 (yu2016: 0). Bags do not contain the position of words on an
    # object. The remaining weight is that of bags, equation 23.
    profile_share: float = 0.5
    # Objects whose height above the ground or extents lie outside the range of the examples of every class by more than
    # this factor are never detected, and are no counterexamples (yu2016: 0, objects of any size). Smaller misses
    # objects unlike the examples; larger costs time.
    size_margin: float = 1.5
    penalty: float = 10.0  # C of the support vector machine. Larger fits single examples more closely.
    # Folds of training scenes. Each is held out by one machine, and thresholds are chosen on the held-out scores.
    folds: int = 5
    rounds: int = 4  # Repetitions of the division into folds. More give more stable scores and cost training time.
    # Largest number of counterexamples: half are the most similar to an example, half are drawn at random. Thresholds
    # are chosen on all objects. Time and memory grow with the square.
    max_others: int = 5000
    seed: int = 2016  # Seed of this sample and of the folds
    # Largest number of queries of a class with "nearest"; the paper states none. Cars differ in make and in the sides
    # that were scanned.
    max_queries: int = 12
    # Largest number of training objects of a class that these queries are selected from: those with the most words
    candidates: int = 200

    def __post_init__(self) -> None:
        for name, least in (("max_queries", 1), ("candidates", 1), ("max_others", 1), ("folds", 2), ("rounds", 1)):
            if getattr(self, name) < least:
                raise ParameterError(f"{name} must be at least {least}, got {getattr(self, name)!r}")
        if self.decision not in ("weighted", "nearest"):
            raise ParameterError(f"decision must be 'weighted' or 'nearest', got {self.decision!r}")
        for name in ("size_share", "profile_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise ParameterError(f"{name} must be between 0 and 1, got {getattr(self, name)!r}")
        if self.size_share + self.profile_share > 1:
            raise ParameterError(
                f"size_share and profile_share must not exceed 1 together, got {self.size_share!r} and "
                f"{self.profile_share!r}"
            )
        if self.size_margin != 0 and not self.size_margin >= 1:
            raise ParameterError(f"size_margin must be 0 or at least 1, got {self.size_margin!r}")
        if not self.penalty > 0:
            raise ParameterError(f"penalty must be above 0, got {self.penalty!r}")

    def similarity(self, queries: Appearance, objects: Appearance) -> NDArray[np.float64]:
        """Return the similarity of objects to queries with these weights of sizes and profiles."""
        return appearance_similarity(queries, objects, size_share=self.size_share, profile_share=self.profile_share)


@dataclass(frozen=True)
class HeldOut:
    """Scores of training objects by machines trained without their scenes, for threshold selection."""

    scores: NDArray[np.float64]  # Score of each class; 0 where no machine was trained on other examples of it
    labels: NDArray[np.integer]  # Class of each object, -1 for others
    scenes: NDArray  # Scene of each


@dataclass(frozen=True)
class ClassQueries:
    """Queries and threshold of a class."""

    appearance: Appearance  # The queries
    weights: NDArray[np.float64]  # Their weights; empty where the score is the similarity to the most similar query
    offset: float  # Offset of the weighted sum
    threshold: float  # Lowest score at which an object is detected

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the queries as named arrays for `from_arrays`."""
        bags = self.appearance.bags
        return {
            "data": bags.data,
            "indices": bags.indices,
            "indptr": bags.indptr,
            "sizes": self.appearance.sizes,
            "profiles": self.appearance.profiles,
            "weights": self.weights,
            "offset": np.array(self.offset),
            "threshold": np.array(self.threshold),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any], *, n_words: int) -> ClassQueries:
        """Return the queries of arrays of `to_arrays`."""
        shape = (len(arrays["indptr"]) - 1, n_words)
        bags = csr_array((arrays["data"], arrays["indices"], arrays["indptr"]), shape=shape)
        appearance = Appearance(bags, arrays["sizes"], arrays["profiles"])
        return cls(appearance, arrays["weights"], float(arrays["offset"]), float(arrays["threshold"]))
