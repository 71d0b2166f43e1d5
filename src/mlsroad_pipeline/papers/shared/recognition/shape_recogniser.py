"""Base class of the baselines of Luo et al. 2019, which use the shape of an object and not its intensity."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.validation import check_arrays
from mlsroad_pipeline.papers.shared.recognition.object_set import check_training


class ShapeRecogniser(ABC):
    """Recogniser by shape; subclasses implement training and prediction."""

    slug: ClassVar[str]

    def __init__(self, parameters: Any) -> None:
        self.parameters = parameters

    def fit(
        self, objects: Sequence[ArrayLike], classes: ArrayLike, *, intensities: Sequence[ArrayLike] | None = None
    ) -> Self:
        """Train."""
        del intensities
        self.classes_, target = check_training(objects, classes, method=self.slug)
        self._learn(objects, target)
        return self

    @abstractmethod
    def _learn(self, objects: Sequence[ArrayLike], target: NDArray[np.int64]) -> None:
        """Train on objects and the indices of their classes."""

    def predict_proba(
        self, objects: Sequence[ArrayLike], *, intensities: Sequence[ArrayLike] | None = None
    ) -> NDArray[np.float64]:
        """Return the class probabilities of objects."""
        del intensities
        return self._probabilities(objects) if len(objects) else np.zeros((0, len(self.classes_)))

    @abstractmethod
    def _probabilities(self, objects: Sequence[ArrayLike]) -> NDArray[np.float64]:
        """Return class probabilities; there is at least one object."""

    @abstractmethod
    def to_arrays(self) -> dict[str, NDArray]:
        """Return the fitted state as plain arrays."""

    @classmethod
    def _restored(cls, arrays: Mapping[str, NDArray], parameters: Any, *names: str) -> Self:
        """Return a recogniser with parameters and classes after checking that all arrays are present."""
        check_arrays(arrays, ("classes", *names), f"{cls.slug}")
        self = cls(parameters)
        self.classes_ = np.array(arrays["classes"])
        return self

    def describe(self) -> dict[str, object]:
        """Return the parameters as JSON values."""
        return asdict(self.parameters)
