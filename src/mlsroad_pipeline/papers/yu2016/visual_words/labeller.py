"""Trained vocabulary and detector (Yu et al. 2016, section IV)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.models.bundle import arrays_under
from mlsroad_pipeline.papers.shared.detection.types import Description
from mlsroad_pipeline.papers.yu2016.visual_words.appearance import count_words
from mlsroad_pipeline.papers.yu2016.visual_words.detector import VisualWordsDetector
from mlsroad_pipeline.papers.yu2016.visual_words.groups import ContextualGroups, groups_of, profiles_of
from mlsroad_pipeline.papers.yu2016.visual_words.vocabulary import Vocabulary


def bag_objects(
    arrays: Description, vocabulary: Vocabulary, *, intensity: bool, wanted: NDArray[np.bool_] | None = None
) -> csr_array:
    """Count the words of the objects of a scene."""
    owner, groups = arrays["objects"], groups_of(arrays, intensity=intensity)
    if wanted is not None:
        rows = np.flatnonzero(wanted[owner])
        owner, groups = owner[rows], groups.select(rows)
    words = vocabulary.quantise(groups)
    return count_words(words, owner, n_objects=int(arrays["n_objects"]), stopped=vocabulary.stopped)


@dataclass(frozen=True)
class VisualWords:
    """Trained vocabulary and detector; see `TrainedDetector`."""

    vocabulary: Vocabulary
    detector: VisualWordsDetector
    intensity: bool  # Whether intensity is used

    @property
    def thresholds(self) -> NDArray[np.float64]:
        """Lowest score of each class at which an object is detected."""
        return self.detector.thresholds

    def score(self, parts: Description) -> NDArray[np.float64]:
        """Return the scores of objects described by `describe_objects`."""
        possible = self.detector.possible(parts["sizes"])
        counts = bag_objects(parts, self.vocabulary, intensity=self.intensity, wanted=possible)
        return self.detector.score(counts, parts["sizes"], profiles_of(parts, intensity=self.intensity))

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the trained state as plain arrays."""
        words, own = self.vocabulary.words, self.vocabulary
        learned = {
            "descriptors": words.descriptors, "orientations": words.orientations, "scales": words.scales,
            "inverse": own.inverse, "stopped": own.stopped, "floor": np.array(own.floor),
        }  # fmt: skip
        return {**{f"words.{name}": values for name, values in learned.items()}, **self.detector.to_arrays()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], *, intensity: bool) -> Self:
        """Rebuild a vocabulary and its detector."""
        own = arrays_under(arrays, "words.")
        words = ContextualGroups(own["descriptors"], own["orientations"], own["scales"])
        vocabulary = Vocabulary(words, own["inverse"], own["stopped"], float(own["floor"]))
        return cls(vocabulary, VisualWordsDetector.from_arrays(arrays), intensity)
