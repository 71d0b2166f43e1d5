"""Detection with a trained model (Yu et al. 2016, section IV)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under
from mlsroad_pipeline.papers.shared.detection.detector import WITH_INTENSITY, choose_variant, label_described_objects
from mlsroad_pipeline.papers.shared.detection.thresholds import detect_by_thresholds
from mlsroad_pipeline.papers.shared.detection.types import Description, Detections, Segments
from mlsroad_pipeline.papers.yu2016.visual_words.appearance import count_words
from mlsroad_pipeline.papers.yu2016.visual_words.detector import VisualWordsDetector
from mlsroad_pipeline.papers.yu2016.visual_words.groups import (
    ContextualGroups,
    GroupParameters,
    describe_objects,
    groups_of,
    profiles_of,
)
from mlsroad_pipeline.papers.yu2016.visual_words.vocabulary import Vocabulary

SLUG, PRINTED_SLUG = "visual_words", "visual_words_printed"


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


def model_of(bundle: ModelBundle, variant: str) -> tuple[Vocabulary, VisualWordsDetector]:
    """Rebuild a vocabulary and its detector."""
    arrays = arrays_under(bundle.arrays, f"{variant}.")
    words = ContextualGroups(arrays["words.descriptors"], arrays["words.orientations"], arrays["words.scales"])
    vocabulary = Vocabulary(words, arrays["words.inverse"], arrays["words.stopped"], float(arrays["words.floor"]))
    return vocabulary, VisualWordsDetector.from_arrays(arrays)


def detect_scene(arrays: Description, bundle: ModelBundle) -> Detections:
    """Detect the objects of a scene."""
    variant = choose_variant(arrays, bundle)
    vocabulary, detector = model_of(bundle, variant)
    intensity = variant == WITH_INTENSITY
    counts = bag_objects(arrays, vocabulary, intensity=intensity, wanted=detector.possible(arrays["sizes"]))
    scores = detector.score(counts, arrays["sizes"], profiles_of(arrays, intensity=intensity))
    label, score = detect_by_thresholds(scores, detector.thresholds)
    return {"label": label, "score": score, "scores": scores.astype(np.float32)}


def _describe(scene: PointCloud, objects: Segments, stored: Mapping[str, Any]) -> dict[str, NDArray]:
    return describe_objects(scene, objects, parameters=GroupParameters(**stored["groups"]))


label_cloud = partial(label_described_objects, describe=_describe, detect=detect_scene)
"""Labels a cloud; intensity is used where the cloud and the model have it."""
