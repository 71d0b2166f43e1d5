"""What the stages of the inventory ask of a trained judge, and what they decide with its answers."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

STEM = "stem"
"""Question about an upright line: is it a trunk, a pole or post, or neither."""

TRUNK, POLE, NEITHER = range(3)
"""Columns of the answers about stems."""


class Judge(Protocol):
    """A trained judge: `models.object_judge.ObjectJudge`."""

    def probabilities(self, question: str, features: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the probabilities of the answers, shape (n, answers).

        The question is `STEM` or a kind of object; of a kind there is one answer: that it is an object of this kind.
        """

    def reasons(self, question: str, features: NDArray[np.float32]) -> list[str]:
        """Return for each object what its score rests on, in phrases separated by semicolons."""
