"""Worker functions of the study of Yu et al. 2016: train detectors and detect on described objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.papers.shared.detection.detector import DetectionStages, detect_objects
from mlsroad_pipeline.papers.shared.detection.scoring import (
    DetectionParameters,
    ObjectClasses,
    count_detections_of_scene,
)
from mlsroad_pipeline.papers.shared.studies.streets import timed
from mlsroad_pipeline.papers.yu2016.study.parameters import survey_of_run


class TrainingStreet(TypedDict):
    """Descriptions and classes of the objects of a training street."""

    parts: Mapping[str, NDArray]
    classes: ObjectClasses


class TestStreet(TypedDict):
    """Descriptions of the objects of a test street, and handles of its points and objects."""

    parts: Mapping[str, NDArray]
    scene: tuple[Any, Any]


class StreetDetections(TypedDict):
    """Detections in a test street compared with its reference, see `count_detections_of_scene`."""

    n_objects: NDArray[np.integer]  # (classes,): reference objects of each class
    # label, right, score: (detections,): class, correctness and score of each detection
    label: NDArray[np.integer]
    right: NDArray[np.bool_]
    score: NDArray[np.floating]
    # curve_label, curve_right, curve_score: the same for all candidates of precision-recall curves
    curve_label: NDArray[np.integer]
    curve_right: NDArray[np.bool_]
    curve_score: NDArray[np.floating]
    seconds: NDArray[np.floating]  # CPU time of detection


def train_and_detect(
    train: Mapping[str, TrainingStreet],
    test: Mapping[str, TestStreet],
    *,
    method: str,
    parameters: Any,
    stages: DetectionStages,
    detection: DetectionParameters,
    scheme: ClassScheme,
    prevalence: Mapping[str, Mapping[str, float]],
    rare: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Train a detector and compare its detections in test streets with the reference.

    The result has the `StreetDetections` of each test street, and ``facts`` of the training.
    """
    weights = rare or {}
    labels: dict[str, dict[str, Any]] = {
        key: {**street["classes"], "weight": weights.get(key, 1.0)} for key, street in train.items()
    }
    usual = {key: classes for key, classes in labels.items() if key not in weights}
    known = replace(detection, prevalence=joint_prevalence(usual, prevalence, detection.classes))
    bundle, train_seconds = timed(
        METHODS[method].load("train"),
        {key: street["parts"] for key, street in train.items()}, labels, slug=method, parameters=parameters,
        stages=stages, detection=known, scheme=scheme, trained_on={"streets": len(train)},
    )  # fmt: skip
    own = np.concatenate([classes["label"][classes["own"]] for classes in labels.values()])
    variant = next(iter(bundle.metadata["learned"].values()))
    learned = variant["thresholds"]
    facts = {
        "train_seconds": np.array(train_seconds),
        "words": np.array(variant.get("words", 0)),
        "examples": np.bincount(own[own >= 0], minlength=len(detection.classes)),
        "thresholds": np.array([learned.get(name, np.inf) for name in detection.classes]),
    }
    results: dict[str, Any] = {"facts": facts}
    for key, street in test.items():
        detections, seconds = timed(detect_objects, street["parts"], bundle)
        points, objects = (handle.load() for handle in street["scene"])
        counts = count_detections_of_scene(points, objects, detections, scheme=scheme, parameters=detection)
        results[key] = {**counts, "seconds": np.array(seconds)}
    return results


def joint_prevalence(
    labels: Mapping[str, Mapping[str, NDArray]], prevalence: Mapping[str, Mapping[str, float]], classes: Sequence[str]
) -> dict[str, float]:
    """Return the prevalence factors of the joined surveys of one model."""
    expected, counted = np.zeros(len(classes)), np.zeros(len(classes))
    for street, objects in labels.items():
        own = prevalence[survey_of_run(street)]
        mine = objects["label"][objects["own"]]
        number = np.bincount(mine[mine >= 0], minlength=len(classes))
        counted += number
        expected += number * [float(own.get(name, 1.0)) for name in classes]
    return {name: float(e / n) for name, e, n in zip(classes, expected, counted, strict=True) if n > 0}
