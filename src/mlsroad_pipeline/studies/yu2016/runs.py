"""Training and detection on described objects, as the workers of the study of Yu et al. 2016 run them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.detection.detector import DetectionStages
from mlsroad_pipeline.algorithms.detection.scoring import DetectionParameters, count_detections_of_scene
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.studies.streets import timed


def train_and_detect(
    train: Mapping[str, Mapping[str, Any]],
    test: Mapping[str, Mapping[str, Any]],
    *,
    method: str,
    parameters: Any,
    stages: DetectionStages,
    detection: DetectionParameters,
    scheme: ClassScheme,
    prevalence: Mapping[str, Mapping[str, float]],
    rare: Mapping[str, float] | None = None,
) -> dict[str, dict[str, NDArray]]:
    """Train a detector on streets and compare its detections in others with what is there."""
    judge: dict[str, Any] = {"scheme": scheme, "parameters": detection}
    odd = rare or {}
    labels = {key: {**given["classes"], "weight": odd.get(key, 1.0)} for key, given in train.items()}
    usual = {key: found for key, found in labels.items() if key not in odd}
    known = replace(detection, prevalence=joint_prevalence(usual, prevalence, detection.classes))
    bundle, train_seconds = timed(
        METHODS[method].load("train"),
        {key: given["parts"] for key, given in train.items()}, labels, parameters=parameters, stages=stages,
        detection=known, scheme=scheme, trained_on={"streets": len(train)},
    )  # fmt: skip
    own = np.concatenate([found["label"][found["own"]] for found in labels.values()])
    learned = next(iter(bundle.metadata["learned"].values()))["thresholds"]
    facts = {
        "train_seconds": np.array(train_seconds),
        "examples": np.bincount(own[own >= 0], minlength=len(detection.classes)),
        "thresholds": np.array([learned.get(name, np.inf) for name in detection.classes]),
    }
    results = {"facts": facts}
    detect = METHODS[method].load("use")
    for key, given in test.items():
        found, seconds = timed(detect, given["parts"], bundle)
        points, objects = (handle.load() for handle in given["scene"])
        counts = count_detections_of_scene(points, objects, found, **judge)
        results[key] = {**counts, "seconds": np.array(seconds)}
    return results


def joint_prevalence(
    labels: Mapping[str, Mapping[str, NDArray]], prevalence: Mapping[str, Mapping[str, float]], classes: Sequence[str]
) -> dict[str, float]:
    """Join the factors of surveys that one model learns from."""
    expected, counted = np.zeros(len(classes)), np.zeros(len(classes))
    for street, found in labels.items():
        own = prevalence[street.rpartition("_")[0]]
        mine = found["label"][found["own"]]
        number = np.bincount(mine[mine >= 0], minlength=len(classes))
        counted += number
        expected += number * [float(own.get(name, 1.0)) for name in classes]
    return {name: float(e / n) for name, e, n in zip(classes, expected, counted, strict=True) if n > 0}
