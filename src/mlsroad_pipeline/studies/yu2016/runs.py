"""What the workers of the study of Yu et al. 2016 do with described objects: train and detect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines.bottom_up_top_down import detector as bottom_up_top_down
from mlsroad_pipeline.algorithms.baselines.bottom_up_top_down.training import train_bottom_up_top_down
from mlsroad_pipeline.algorithms.baselines.hough_forest import detector as hough_forest
from mlsroad_pipeline.algorithms.baselines.hough_forest.training import train_hough_forest
from mlsroad_pipeline.algorithms.baselines.object_matching import detector as object_matching
from mlsroad_pipeline.algorithms.baselines.object_matching.training import train_object_matching
from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.detection.detector import DetectionStages
from mlsroad_pipeline.algorithms.detection.scoring import DetectionParameters, count_detections_of_scene
from mlsroad_pipeline.algorithms.visual_words import labeller
from mlsroad_pipeline.algorithms.visual_words.training import train_detector
from mlsroad_pipeline.studies.streets import timed

_TRAIN: Mapping[str, Any] = {
    "hough_forest": train_hough_forest,
    "object_matching": train_object_matching,
    "bottom_up_top_down": train_bottom_up_top_down,
    "visual_words": train_detector,
}
_DETECT: Mapping[str, Any] = {
    module.SLUG: module.detect_scene for module in (labeller, hough_forest, object_matching, bottom_up_top_down)
}


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
        _TRAIN[method],
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
    for key, given in test.items():
        found, seconds = timed(_DETECT[method], given["parts"], bundle)
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
