"""Training, storage and use of recognisers, and labelling of point clouds with them.

A method is imported when it is used; some import PyTorch.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, TypedDict

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.algorithms.metrics.scores import recognition_scores
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS, Method, methods_of
from mlsroad_pipeline.papers.shared.detection.detector import DetectionStages, label_detected_objects
from mlsroad_pipeline.papers.shared.detection.types import ObjectLabels, Segments
from mlsroad_pipeline.papers.shared.recognition.cutting import (
    RecognitionParameters,
    objects_of_segments,
    training_objects,
)
from mlsroad_pipeline.papers.shared.recognition.object_set import ObjectArrays, ObjectSet

logger = logging.getLogger(__name__)


def _recogniser_of(slug: str) -> Method:
    method = METHODS.get(slug)
    if method is None or method.task != "recognition":
        raise ParameterError(f"unknown recogniser {slug!r} (known: {', '.join(methods_of('recognition'))})")
    return method


def make_recogniser(slug: str, parameters: Any) -> Any:
    """Return an untrained recogniser."""
    method = _recogniser_of(slug)
    return method.load("use")(parameters.with_views(method.variant) if method.variant else parameters)


def train_recogniser(
    sets: Sequence[ObjectArrays],
    *,
    slug: str,
    parameters: Any,
    recognition: RecognitionParameters,
    stages: DetectionStages,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
) -> ModelBundle:
    """Train a method and return its model."""
    chosen = training_objects(sets, recognition)
    recogniser = make_recogniser(slug, parameters).fit(chosen.objects, chosen.label, intensities=chosen.intensities)
    metadata = {
        "classes": list(scheme.classes),
        "classes_given": [scheme.classes[int(label)] for label in recogniser.classes_],
        "wanted": list(range(len(scheme))),
        "scheme": asdict(scheme),
        "parameters": {**asdict(stages), "recogniser": recogniser.describe(), "recognition": asdict(recognition)},
        "attributes": ["intensity"] if chosen.intensity is not None and METHODS[slug].uses_intensity else [],
        "learned": {"objects": np.bincount(chosen.label, minlength=len(scheme)).tolist()},
        "trained_on": dict(trained_on),
    }
    return ModelBundle(slug, recogniser.to_arrays(), metadata)


def load_recogniser(bundle: ModelBundle) -> Any:
    """Rebuild the recogniser of a model."""
    method = _recogniser_of(bundle.slug)
    kind, parameters = method.load("use"), method.load("parameters")
    recogniser = kind.from_arrays(bundle.arrays, parameters(**bundle.metadata["parameters"]["recogniser"]))
    labels = np.asarray(recogniser.classes_)
    if labels.dtype.kind not in "iu" or labels.min() < 0 or labels.max() >= len(bundle.classes):
        raise DataError(f"model {bundle.slug!r} has the labels {labels.tolist()}, of {len(bundle.classes)} classes")
    names, expected = [bundle.classes[label] for label in labels], bundle.metadata["classes_given"]
    if names != list(expected):
        raise DataError(
            f"model {bundle.slug!r} was trained on {', '.join(expected)}; its arrays are of {', '.join(names)}"
        )
    return recogniser


class Recognitions(TypedDict):
    """Classes of objects."""

    label: NDArray[np.int16]  # Most probable class
    score: NDArray[np.float32]  # Its probability
    scores: NDArray[np.float32]  # Probabilities of the classes of the scheme; 0 for classes that were not learned


def probabilities(recogniser: Any, objects: ObjectSet, n_classes: int) -> Recognitions:
    """Recognise objects."""
    scores = np.zeros((len(objects), n_classes), dtype=np.float32)
    if len(objects):
        scores[:, recogniser.classes_] = recogniser.predict_proba(objects.objects, intensities=objects.intensities)
    label = scores.argmax(axis=1).astype(np.int16)
    return {"label": label, "score": scores.max(axis=1, initial=0.0), "scores": scores}


def recognise_objects(objects: ObjectArrays, bundle: ModelBundle) -> Recognitions:
    """Recognise a set of objects with a model."""
    return probabilities(load_recogniser(bundle), ObjectSet.from_arrays(objects), len(bundle.classes))


def train_and_recognise(
    train: Mapping[str, ObjectArrays],
    test: ObjectArrays,
    *,
    slug: str,
    parameters: Any,
    recognition: RecognitionParameters,
    n_classes: int,
) -> Recognitions:
    """Train on some folds and recognise another."""
    chosen = training_objects([train[key] for key in sorted(train)], recognition)
    recogniser = make_recogniser(slug, parameters).fit(chosen.objects, chosen.label, intensities=chosen.intensities)
    return probabilities(recogniser, ObjectSet.from_arrays(test), n_classes)


def label_cloud(cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Segment a point cloud and label the points of its objects."""
    recogniser = load_recogniser(bundle)
    min_points = RecognitionParameters(**bundle.metadata["parameters"]["recognition"]).min_points

    def detect(objects: Segments) -> ObjectLabels:
        every = objects_of_segments(cloud, objects["objects"])
        large = np.flatnonzero(np.diff(every.indptr) >= min_points)
        recognised = probabilities(recogniser, every.take(large), len(bundle.classes))
        label, score = every.label, np.zeros(len(every), dtype=np.float32)
        label[large], score[large] = recognised["label"], recognised["score"]
        return {"label": label, "score": score}

    return label_detected_objects(cloud, bundle, detect)


ALL_FOLDS = "test"
"""Split of all folds together in cross-validation."""


def score_recognitions(
    truth: Mapping[str, NDArray[np.integer]],
    predicted: Mapping[str, NDArray[np.integer]],
    *,
    method: str,
    scheme: ClassScheme,
    folds: bool,
) -> tuple[pd.DataFrame, dict[str, NDArray[np.int64]]]:
    """Score recognised objects; objects of unknown class are excluded."""
    matrices: dict[str, NDArray[np.int64]] = {}
    for key, labels in truth.items():
        counted = confusion_matrix(labels, predicted[key], len(scheme))
        for split in (key, ALL_FOLDS) if folds else (SceneKey.parse(key).split,):
            matrices[split] = matrices.get(split, 0) + counted
    if folds:
        matrices[ALL_FOLDS] = matrices.pop(ALL_FOLDS)  # last
    tables = [
        recognition_scores(matrix, method=method, split=split, classes=scheme.classes)
        for split, matrix in matrices.items()
    ]
    return pd.concat(tables, ignore_index=True), matrices
