"""Training of detectors on described objects: samples, weights, variants and the model."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.papers.shared.detection.detector import GEOMETRY, WITH_INTENSITY, DetectionStages
from mlsroad_pipeline.papers.shared.detection.scoring import DetectionParameters, ObjectClasses
from mlsroad_pipeline.papers.shared.detection.thresholds import object_weights
from mlsroad_pipeline.papers.shared.detection.types import Description, object_bounds


class TrainingObjects(NamedTuple):
    """All training objects, as a method fits one variant of a detector to them."""

    parts: Description  # The described objects
    labels: NDArray[np.int16]  # Class of each object; -1 for others
    n_classes: int  # Number of wanted classes
    intensity: bool = False  # Whether to use intensity
    # Weight of each object in threshold selection, see `training_weights`; 1 by default
    weights: NDArray[np.float64] | None = None
    n_threads: int = 1  # Threads; the detector does not depend on it

    def sample(self, parameters: Any) -> TrainingSample:
        """Sample the objects that a detector is fitted to, by `max_per_class`, `max_others` and `seed` of a method.

        Thresholds are chosen on all training objects instead: in the sample, objects of no wanted class are rarer than
        in a street.
        """
        p = parameters
        rows = sample_objects(self.labels, max_per_class=p.max_per_class, max_others=p.max_others, seed=p.seed)
        return TrainingSample(rows, select_objects(self.parts, rows), self.labels[rows])


class TrainingSample(NamedTuple):
    """Sampled training objects."""

    rows: NDArray[np.int64]  # Indices among all training objects, ascending
    parts: Description  # Their description
    labels: NDArray[np.int16]  # Their classes; -1 for others

    def candidates(self, label: int, most: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """Return up to `most` described objects of a class, as indices in the sample, ascending."""
        rows = np.flatnonzero((self.labels == label) & (np.diff(object_bounds(self.parts)) > 0))
        return np.sort(rng.choice(rows, most, replace=False)) if len(rows) > most else rows


def join_descriptions(parts: Sequence[Description], keep: Sequence[NDArray[np.bool_]]) -> dict[str, NDArray]:
    """Join the described objects of scenes, and number those that are kept from 0.

    `keep` has one flag per object of each scene. The joined ``intensity`` is true where all scenes have it.
    """
    if not parts:
        raise DataError("there are no described scenes to join")
    columns = [name for name, values in parts[0].items() if np.ndim(values) and name != "objects"]
    rows: dict[str, list[NDArray]] = {name: [] for name in (*columns, "objects")}
    n = 0
    for scene, kept in zip(parts, keep, strict=True):
        if kept.shape != (int(scene["n_objects"]),):
            raise DataError(f"{kept.shape} flags for {int(scene['n_objects'])} objects")
        number = np.where(kept, np.cumsum(kept) - 1 + n, IGNORE)[scene["objects"]]
        chosen = number >= 0
        rows["objects"].append(number[chosen].astype(np.int32))
        for name in columns:
            rows[name].append(scene[name][chosen])
        n += int(kept.sum())
    joined = {name: np.concatenate(values) for name, values in rows.items()}
    intensity = all(bool(scene["intensity"]) for scene in parts)
    return {**joined, "n_objects": np.array(n), "intensity": np.array(intensity)}


def select_objects(parts: Description, chosen: NDArray[np.int64]) -> dict[str, NDArray]:
    """Select objects of a description by ascending indices, and number them from 0."""
    keep = np.zeros(int(parts["n_objects"]), dtype=np.bool_)
    keep[chosen] = True
    return join_descriptions([parts], [keep])


def sample_objects(labels: NDArray[np.integer], *, max_per_class: int, max_others: int, seed: int) -> NDArray[np.int64]:
    """Return ascending indices of up to `max_per_class` objects of each class and `max_others` of class -1."""
    rng = np.random.default_rng(seed)
    drawn = []
    for label in np.unique(labels):
        mine = np.flatnonzero(labels == label)
        most = max_others if label == IGNORE else max_per_class
        drawn.append(mine if len(mine) <= most else rng.choice(mine, most, replace=False))
    return np.sort(np.concatenate(drawn)).astype(np.int64) if drawn else np.zeros(0, np.int64)


logger = logging.getLogger(__name__)


class DetectorTraining(NamedTuple):
    """Method to train, its parameters, and what its model stores."""

    slug: str
    parameters: Any  # Parameters of the method
    stages: DetectionStages  # Parameters of the stages before it
    detection: DetectionParameters
    scheme: ClassScheme
    trained_on: Mapping[str, Any]  # Description of the training data for the model's metadata
    n_threads: int = 1  # Threads; the model does not depend on it


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
    variants: Mapping[str, tuple[Mapping[str, NDArray], Mapping[str, Any]]],
    training: DetectorTraining,
    **parameters: Mapping[str, Any],
) -> ModelBundle:
    """Return the model of a detector from the arrays and facts of its variants, and parameters of its description."""
    stages, scheme = training.stages, training.scheme
    metadata = {
        "classes": list(scheme.classes),
        "wanted": training.detection.labels_in(scheme).tolist(),
        "scheme": asdict(scheme),
        "parameters": {**asdict(stages), **parameters, training.slug: asdict(training.parameters)},
        "attributes": ["intensity"] if WITH_INTENSITY in variants else [],
        "variants": list(variants),
        "learned": {name: dict(facts) for name, (_, facts) in variants.items()},
        "trained_on": dict(training.trained_on),
    }
    arrays = {f"{name}.{key}": part for name, (own, _) in variants.items() for key, part in own.items()}
    return ModelBundle(training.slug, arrays, metadata)


def train_object_detector(
    parts: Mapping[str, Description], labels: Mapping[str, ObjectClasses], training: DetectorTraining
) -> ModelBundle:
    """Train a detector on the objects that the training scenes own, by `fit` of its class.

    The model never detects a class without training objects; a warning is logged.
    """
    keys, detection = training_keys(labels), training.detection
    joined = join_descriptions([parts[key] for key in keys], [labels[key]["own"] for key in keys])
    truth = np.concatenate([labels[key]["label"][labels[key]["own"]] for key in keys])
    weights = training_weights([labels[key] for key in keys], detection.factors)
    described = np.diff(object_bounds(joined)) > 0
    for number, name in enumerate(detection.classes):
        if not (described & (truth == number)).any():
            logger.warning("No training object is a %s: the model never detects one", name)
    objects = TrainingObjects(joined, truth, len(detection.classes), weights=weights, n_threads=training.n_threads)
    variants: dict[str, tuple[dict[str, NDArray], dict[str, Any]]] = {}
    method = METHODS[training.slug]
    for variant in [WITH_INTENSITY, GEOMETRY] if method.uses_intensity and bool(joined["intensity"]) else [GEOMETRY]:
        own = objects._replace(intensity=variant == WITH_INTENSITY)
        detector, facts = method.load("use").fit(own, training.parameters)
        thresholds = zip(detection.classes, detector.thresholds.tolist(), strict=True)
        facts["thresholds"] = {name: value for name, value in thresholds if np.isfinite(value)}
        variants[variant] = detector.to_arrays(), facts
    return bundle_variants(variants, training)
