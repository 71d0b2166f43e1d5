"""How queries and thresholds are chosen, and the queries of a class (Yu et al. 2016, IV-C)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.visual_words.appearance import Appearance


@dataclass(frozen=True)
class DetectorParameters:
    """How queries and thresholds are chosen, and what counts as alike.

    Parameters
    ----------
    decision : {"weighted", "nearest"}, default "weighted"
        With "nearest" an object's score is its likeness to the most similar of a few queries of the class, as in the
        paper. With "weighted" all training objects may be queries, those of no wanted class too, and the score is
        their weighted vote: a support vector machine whose kernel is the likeness.
    size_share : float, default 0.25
        Share of the size in the likeness of two objects, 0 to 1. 0 is as printed. Bags are shares of words and do not
        tell a small object from a large one.
    profile_share : float, default 0.5
        Share of the profile, where the object's substance lies and how bright it is there, 0 to 1. 0 is as printed.
        Bags do not tell what is high on an object from what is low. The rest is the likeness of bags, equation 23.
    size_margin : float, default 1.5
        Objects whose height above the ground or extents lie outside the range of all examples of all classes by more
        than this factor are never detected, and are no counterexamples; 0 looks at objects of any size, as printed.
        Smaller misses objects unlike the examples; larger costs time.
    penalty : float, default 10
        Of training objects on the wrong side of the weighted vote. Larger follows single examples more closely.
    folds : int, default 5
        Groups of training scenes that are held out in turn: each gives a machine that votes, and scores the scenes that
        it has not seen, which thresholds are chosen by.
    rounds : int, default 4
        How often scenes are divided into such groups anew. More votes make scores steadier and cost training time.
    max_others : int, default 5000
        The most training objects of no wanted class that take part in it: half of them those most like an example,
        half drawn at random. Thresholds are chosen on all. Larger costs time and memory with its square.
    seed : int, default 2016
        Of this draw and of the folds.
    max_queries : int, default 12
        The most queries of a class with "nearest". The paper names none; one complete car does not stand for every
        make and every side that it is seen from.
    candidates : int, default 200
        Training objects of a class that may become these queries: those with the most words.

    Raises
    ------
    ParameterError
        If a value is outside its domain.
    """

    decision: Literal["weighted", "nearest"] = "weighted"
    size_share: float = 0.25
    profile_share: float = 0.5
    size_margin: float = 1.5
    penalty: float = 10.0
    folds: int = 5
    rounds: int = 4
    max_others: int = 5000
    seed: int = 2016
    max_queries: int = 12
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


@dataclass(frozen=True)
class HeldOut:
    """How training objects are scored by machines that have not seen their scenes: what thresholds are chosen by.

    Attributes
    ----------
    scores : ndarray of float64, shape (m, classes)
        Score of each class; 0 where no machine has seen other examples of it.
    labels : ndarray of int, shape (m,)
        Class of each object, -1 for others.
    scenes : ndarray, shape (m,)
        Scene of each.
    """

    scores: NDArray[np.float64]
    labels: NDArray[np.integer]
    scenes: NDArray


@dataclass(frozen=True)
class ClassQueries:
    """What one class is looked for with.

    Attributes
    ----------
    looks : Appearance
        The queries.
    weights : ndarray of float64, shape (q,)
        Their weights; none where the most similar query decides.
    offset : float
        Added to the weighted sum.
    threshold : float
        Score from which an object is detected.
    """

    looks: Appearance
    weights: NDArray[np.float64]
    offset: float
    threshold: float
