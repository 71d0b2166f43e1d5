"""What the workers of the study of Luo et al. 2019 do: train a recogniser and let it recognise disturbed objects."""

from __future__ import annotations

import importlib
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.recognition.disturbances import Disturbance, disturb
from mlsroad_pipeline.algorithms.recognition.object_set import ObjectArrays, ObjectSet
from mlsroad_pipeline.algorithms.recognition.recogniser import make_recogniser, probabilities
from mlsroad_pipeline.studies.luo2019.sets import StreetObjects


def disturb_objects(objects: ObjectSet, disturbance: Disturbance, seed: int) -> ObjectSet:
    """Disturb each object of a set."""
    if disturbance == Disturbance() or not len(objects):
        return objects
    seeds = np.random.SeedSequence(seed).generate_state(len(objects), np.uint64)
    intensities = objects.intensities
    found = [
        disturb(xyz, disturbance, seed=int(own), intensity=None if intensities is None else intensities[i])
        for i, (xyz, own) in enumerate(zip(objects.objects, seeds, strict=True))
    ]
    values = None if intensities is None else [value for _, value in found if value is not None]
    return ObjectSet.from_objects([xyz for xyz, _ in found], objects.label, values)


def mislabel(objects: ObjectSet, share: float, seed: int) -> ObjectSet:
    """Give some objects a wrong class."""
    rng = np.random.default_rng(seed)
    rows = rng.choice(len(objects), round(share * len(objects)), replace=False)
    classes, own = np.unique(objects.label, return_inverse=True)
    other = own.copy()
    other[rows] = (own[rows] + rng.integers(1, max(len(classes), 2), len(rows))) % len(classes)
    return ObjectSet(objects.xyz, objects.indptr, classes[other], objects.intensity)


def train_and_recognise(
    train: Mapping[str, ObjectArrays],
    test: StreetObjects,
    validation: ObjectArrays | None = None,
    *,
    method: str,
    settings: Sequence[Any],
    conditions: Mapping[str, Disturbance],
    disturbance: Disturbance,
    wrong_labels: float,
    n_classes: int,
    seed: int,
) -> dict[str, dict[str, NDArray]]:
    """Train a recogniser and let it recognise test objects under every disturbance."""
    learned = ObjectSet.join([ObjectSet.from_arrays(train[key]) for key in sorted(train)])
    learned = mislabel(disturb_objects(learned, disturbance, seed + 1), wrong_labels, seed + 2)
    fitted, tried, seconds = [], [], []
    for parameters in settings:
        start = time.process_time()
        recogniser = make_recogniser(method, parameters)
        fitted.append(recogniser.fit(learned.objects, learned.label, intensities=learned.intensities))
        seconds.append(time.process_time() - start)
        tried.append(
            np.nan if validation is None else _accuracy(recogniser, ObjectSet.from_arrays(validation), n_classes)
        )
    chosen = int(np.argmax(tried)) if validation is not None else 0
    given, found = ObjectSet.from_arrays(test), fitted[chosen]
    probabilities(found, given.take(np.arange(min(len(given), 1))), n_classes)  # compiles what the times shall not have
    scores, times = [], []
    for level in conditions.values():
        objects = disturb_objects(given, level, seed)
        start = time.process_time()
        scores.append(probabilities(found, objects, n_classes)["scores"])
        times.append(time.process_time() - start)
    describe = getattr(found, "describe_objects", None)
    facts = {
        "train_seconds": np.array(seconds[chosen]),
        "model_bytes": np.array(sum(array.nbytes for array in found.to_arrays().values())),
        "objects": np.array(len(learned)),
        "dimension": np.array(0 if describe is None else describe(given.objects[:1], found.radius_).shape[1]),
        "tried": np.array(tried),
        "chosen": np.array(chosen),
    }
    results: dict[str, NDArray] = {
        "scores": np.stack(scores),
        "label": given.label,
        "street": np.asarray(test.get("street", np.arange(len(given)))),
        "seconds": np.array(times),
    }
    return {"results": results, "facts": facts}


def _accuracy(recogniser: Any, objects: ObjectSet, n_classes: int) -> float:
    return float((probabilities(recogniser, objects, n_classes)["label"] == objects.label).mean())


def measure_network(*, parameters: Any, n_classes: int) -> dict[str, NDArray]:
    """Measure one network as `luo2019_efficiency.measure_network` does; PyTorch is imported here alone."""
    module = importlib.import_module("mlsroad_pipeline.studies.luo2019.efficiency")
    found: dict[str, NDArray] = module.measure_network(parameters=parameters, n_classes=n_classes)
    return found
