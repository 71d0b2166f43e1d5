"""Training of detectors on described objects: weights, variants and the model."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.papers.shared.detection.detector import GEOMETRY, WITH_INTENSITY, DetectionStages, TrainedDetector
from mlsroad_pipeline.papers.shared.detection.sampling import TrainingObjects, join_descriptions
from mlsroad_pipeline.papers.shared.detection.scoring import DetectionParameters, ObjectClasses
from mlsroad_pipeline.papers.shared.detection.thresholds import object_weights
from mlsroad_pipeline.papers.shared.detection.types import Description, object_bounds

logger = logging.getLogger(__name__)


class FittedVariant(NamedTuple):
    """One variant of a trained detector."""

    arrays: Mapping[str, NDArray]  # Its state
    facts: Mapping[str, Any]  # Figures of its training; JSON values


def training_weights(scenes: Sequence[ObjectClasses], prevalence: NDArray[np.floating]) -> NDArray[np.float64]:
    """Weigh the objects that training scenes own."""
    own = [scene["label"][scene["own"]] for scene in scenes]
    each = [float(scene.get("weight", 1.0)) for scene in scenes]
    return np.concatenate([w * object_weights(labels, prevalence) for labels, w in zip(own, each, strict=True)])


def training_keys(labels: Mapping[str, ObjectClasses]) -> list[str]:
    """Return the keys of the training scenes, sorted."""
    if not labels:
        raise DataError("no training scenes: the split 'train' is empty")
    return sorted(labels)


def bundle_variants(
    variants: Mapping[str, FittedVariant],
    *,
    slug: str,
    parameters: Mapping[str, Any],
    stages: DetectionStages,
    detection: DetectionParameters,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
) -> ModelBundle:
    """Return the model of a detector."""
    metadata = {
        "classes": list(scheme.classes),
        "wanted": detection.labels_in(scheme).tolist(),
        "scheme": asdict(scheme),
        "parameters": {**asdict(stages), **parameters},
        "attributes": ["intensity"] if WITH_INTENSITY in variants else [],
        "variants": list(variants),
        "learned": {name: dict(variant.facts) for name, variant in variants.items()},
        "trained_on": dict(trained_on),
    }
    arrays = {f"{name}.{key}": part for name, variant in variants.items() for key, part in variant.arrays.items()}
    return ModelBundle(slug, arrays, metadata)


def train_object_detector(
    parts: Mapping[str, Description],
    labels: Mapping[str, ObjectClasses],
    *,
    fit: Callable[[TrainingObjects, Any], tuple[TrainedDetector, dict[str, Any]]],
    slug: str,
    uses_intensity: bool,
    parameters: Any,
    stages: DetectionStages,
    detection: DetectionParameters,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
    n_threads: int = 1,
) -> ModelBundle:
    """Train a detector on the objects that the training scenes own.

    The model never detects a class without training objects; a warning is logged.
    """
    keys = training_keys(labels)
    joined = join_descriptions([parts[key] for key in keys], [labels[key]["own"] for key in keys])
    truth = np.concatenate([labels[key]["label"][labels[key]["own"]] for key in keys])
    weights = training_weights([labels[key] for key in keys], detection.factors)
    described = np.diff(object_bounds(joined)) > 0
    for number, name in enumerate(detection.classes):
        if not (described & (truth == number)).any():
            logger.warning("No training object is a %s: the model never detects one", name)
    objects = TrainingObjects(joined, truth, len(detection.classes), weights=weights, n_threads=n_threads)
    variants: dict[str, FittedVariant] = {}
    for variant in [WITH_INTENSITY, GEOMETRY] if uses_intensity and bool(joined["intensity"]) else [GEOMETRY]:
        detector, facts = fit(objects._replace(intensity=variant == WITH_INTENSITY), parameters)
        thresholds = zip(detection.classes, detector.thresholds.tolist(), strict=True)
        facts["thresholds"] = {name: value for name, value in thresholds if np.isfinite(value)}
        variants[variant] = FittedVariant(detector.to_arrays(), facts)
    return bundle_variants(
        variants, slug=slug, parameters={slug: asdict(parameters)}, stages=stages,
        detection=detection, scheme=scheme, trained_on=trained_on,
    )  # fmt: skip
