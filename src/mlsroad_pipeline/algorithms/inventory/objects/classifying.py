"""Interface of the object classifier, and the decisions that depend on its scores."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

STEM = "stem"
"""Name of the classifier of upright lines: trunk, pole or post, or neither."""

TRUNK, POLE, NEITHER = range(3)
"""Columns of the probabilities of stems."""


class Classifier(Protocol):
    """A trained object classifier: `object_classifier.ObjectClassifier`."""

    def probabilities(self, classifier: str, features: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the probabilities of the classes of a classifier."""

    def reasons(self, classifier: str, features: NDArray[np.float32]) -> list[str]:
        """Return what the score of each candidate rests on."""
