"""What the training of detectors shares: joined and drawn objects, queries, the model."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.detection.descriptions import Description, object_bounds
from mlsroad_pipeline.algorithms.detection.detector import GEOMETRY, WITH_INTENSITY, DetectionStages, TrainedDetector
from mlsroad_pipeline.algorithms.detection.scoring import DetectionParameters
from mlsroad_pipeline.algorithms.detection.thresholds import best_threshold, training_weights
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle

logger = logging.getLogger(__name__)

Fit = Callable[..., tuple[TrainedDetector, dict[str, Any]]]
"""Parts of the training objects, class of each object, whether intensities count, and the keyword ``weights``, how
often each object counts when thresholds are chosen: a detector and facts about it."""


def join_descriptions(parts: Sequence[Description], keep: Sequence[NDArray[np.bool_]]) -> dict[str, NDArray]:
    """Join the described objects of scenes, and number those that are kept from 0.

    Parameters
    ----------
    parts : sequence of mapping
        Description of each scene.
    keep : sequence of ndarray of bool, shape (objects of the scene,)
        Objects that are wanted.

    Returns
    -------
    dict of str to ndarray
        One description; ``intensity`` where all scenes have it.

    Raises
    ------
    DataError
        If there is no scene, or not one flag per object.
    """
    if not parts:
        raise DataError("there are no described scenes to join")
    columns = [name for name, values in parts[0].items() if np.ndim(values) and name != "objects"]
    rows: dict[str, list[NDArray]] = {name: [] for name in (*columns, "objects")}
    n = 0
    for found, wanted in zip(parts, keep, strict=True):
        if wanted.shape != (int(found["n_objects"]),):
            raise DataError(f"{wanted.shape} flags for {int(found['n_objects'])} objects")
        number = np.where(wanted, np.cumsum(wanted) - 1 + n, IGNORE)[found["objects"]]
        chosen = number >= 0
        rows["objects"].append(number[chosen].astype(np.int32))
        for name in columns:
            rows[name].append(found[name][chosen])
        n += int(wanted.sum())
    joined = {name: np.concatenate(values) for name, values in rows.items()}
    intensity = all(bool(found["intensity"]) for found in parts)
    return {**joined, "n_objects": np.array(n), "intensity": np.array(intensity)}


def select_objects(parts: Description, chosen: NDArray[np.int64]) -> dict[str, NDArray]:
    """Take some objects of a description, numbered as they are given.

    Parameters
    ----------
    parts : mapping
        The description.
    chosen : ndarray of int64
        The objects, ascending.

    Returns
    -------
    dict of str to ndarray
        Their description.
    """
    wanted = np.zeros(int(parts["n_objects"]), dtype=np.bool_)
    wanted[chosen] = True
    return join_descriptions([parts], [wanted])


def sample_objects(labels: NDArray[np.integer], *, max_per_class: int, max_others: int, seed: int) -> NDArray[np.int64]:
    """Draw training objects.

    Parameters
    ----------
    labels : ndarray of int, shape (n,)
        Class of each object, -1 for others.
    max_per_class, max_others : int
        The most objects of each class, and of all others.
    seed : int
        Seed of the draw.

    Returns
    -------
    ndarray of int64
        The drawn objects, ascending.
    """
    rng = np.random.default_rng(seed)
    drawn = []
    for label in np.unique(labels):
        mine = np.flatnonzero(labels == label)
        most = max_others if label == IGNORE else max_per_class
        drawn.append(mine if len(mine) <= most else rng.choice(mine, most, replace=False))
    return np.sort(np.concatenate(drawn)).astype(np.int64) if drawn else np.zeros(0, np.int64)


def choose_queries(
    likeness: NDArray[np.float64], candidates: NDArray[np.int64], truth: NDArray[np.bool_], *, max_queries: int
) -> tuple[list[int], float, float]:
    """Choose what a class is looked for with: one by one the candidate that raises the F-score on the objects most.

    Parameters
    ----------
    likeness : ndarray of float64, shape (k, n)
        Likeness of each object to each candidate.
    candidates : ndarray of int64, shape (k,)
        Which of the objects each candidate is: nothing is found by itself.
    truth : ndarray of bool, shape (n,)
        Whether each object is of the class.
    max_queries : int
        The most that are chosen.

    Returns
    -------
    chosen : list of int
        Places among the candidates.
    threshold : float
        The best threshold on the likeness to the nearest of them.
    f_score : float
        The F-score that it reaches.
    """
    likeness = likeness.copy()
    likeness[np.arange(len(candidates)), candidates] = 0.0
    best = np.zeros(likeness.shape[1])
    chosen: list[int] = []
    reached, threshold = -1.0, float("inf")
    while len(chosen) < min(max_queries, len(candidates)):
        trials = [
            (-1.0, float("inf")) if k in chosen else best_threshold(np.maximum(best, row), truth)
            for k, row in enumerate(likeness)
        ]
        k = int(np.argmax([value for value, _ in trials]))
        if trials[k][0] <= reached:
            break
        reached, threshold = trials[k]
        chosen.append(k)
        best = np.maximum(best, likeness[k])
    return chosen, threshold, reached


def train_object_detector(
    parts: Mapping[str, Description],
    labels: Mapping[str, Mapping[str, NDArray]],
    fit: Fit,
    *,
    slug: str,
    parameters: Any,
    uses_intensity: bool,
    stages: DetectionStages,
    detection: DetectionParameters,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
) -> ModelBundle:
    """Train a detector on the objects that the training scenes own.

    A class without training objects is warned of and never detected.

    Parameters
    ----------
    parts : mapping of str to mapping
        Description of each training scene.
    labels : mapping of str to mapping
        What `object_classes` gave for each of them; a ``weight`` beside it is known to `training_weights`.
    fit : callable
        Trains one variant.
    slug : str
        The method.
    parameters : dataclass
        Parameters of the method.
    uses_intensity : bool
        Whether the method looks at intensities: then there are variants with them, where all scenes have them, and
        without.
    stages : DetectionStages
        How the scenes were prepared.
    detection : DetectionParameters
        The wanted classes.
    scheme : ClassScheme
        The classes.
    trained_on : mapping
        What the metadata say of the training data; JSON values.

    Returns
    -------
    ModelBundle
        The model.

    Raises
    ------
    DataError
        If there are no training scenes.
    """
    keys = sorted(labels)
    if not keys:
        raise DataError("no training scenes: the split 'train' is empty")
    joined = join_descriptions([parts[key] for key in keys], [labels[key]["own"] for key in keys])
    truth = np.concatenate([labels[key]["label"][labels[key]["own"]] for key in keys])
    weights = training_weights([labels[key] for key in keys], detection.factors)
    described = np.diff(object_bounds(joined)) > 0
    for number, name in enumerate(detection.classes):
        if not (described & (truth == number)).any():
            logger.warning("No training object is a %s: the model never detects one", name)
    intensity = uses_intensity and bool(joined["intensity"])
    variants = [WITH_INTENSITY, GEOMETRY] if intensity else [GEOMETRY]
    arrays: dict[str, NDArray] = {}
    facts: dict[str, Any] = {}
    for variant in variants:
        detector, facts[variant] = fit(joined, truth, variant == WITH_INTENSITY, weights=weights)
        arrays |= {f"{variant}.{name}": values for name, values in detector.to_arrays().items()}
        found = zip(detection.classes, detector.thresholds.tolist(), strict=True)
        facts[variant]["thresholds"] = {name: value for name, value in found if np.isfinite(value)}
    metadata = {
        "classes": list(scheme.classes),
        "wanted": detection.labels_in(scheme).tolist(),
        "scheme": asdict(scheme),
        "parameters": {**asdict(stages), slug: asdict(parameters)},
        "attributes": ["intensity"] if intensity else [],
        "variants": variants,
        "learned": facts,
        "trained_on": dict(trained_on),
    }
    return ModelBundle(slug, arrays, metadata)


class Trainer(Protocol):
    """Trains a model on the objects that the training scenes own; the model does not depend on the threads."""

    def __call__(
        self,
        parts: Mapping[str, Description],
        labels: Mapping[str, Mapping[str, NDArray]],
        *,
        parameters: Any,
        stages: DetectionStages,
        detection: DetectionParameters,
        scheme: ClassScheme,
        trained_on: Mapping[str, Any],
        n_threads: int = 1,
    ) -> ModelBundle:
        """Train; see `train_object_detector` for what is given."""
        ...


def make_trainer(
    fit: Callable[..., tuple[TrainedDetector, dict[str, Any]]], *, slug: str, uses_intensity: bool
) -> Trainer:
    """Return the function that trains models of a method.

    Parameters
    ----------
    fit : callable
        Trains one variant on parts, classes and whether intensities count, with the keywords ``parameters``,
        ``n_classes``, ``weights`` and ``n_threads``.
    slug : str
        The method.
    uses_intensity : bool
        Whether the method looks at intensities.

    Returns
    -------
    Trainer
        The function.
    """

    def train(
        parts: Mapping[str, Description],
        labels: Mapping[str, Mapping[str, NDArray]],
        *,
        parameters: Any,
        stages: DetectionStages,
        detection: DetectionParameters,
        scheme: ClassScheme,
        trained_on: Mapping[str, Any],
        n_threads: int = 1,
    ) -> ModelBundle:
        given = {"parameters": parameters, "n_classes": len(detection.classes), "n_threads": n_threads}
        return train_object_detector(
            parts, labels, partial(fit, **given), slug=slug, parameters=parameters,
            uses_intensity=uses_intensity, stages=stages, detection=detection, scheme=scheme, trained_on=trained_on,
        )  # fmt: skip

    return train
