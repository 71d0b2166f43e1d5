"""Worker functions of the study of Luo et al. 2019: train recognisers, recognise disturbed objects."""

import time
from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.papers.luo2019.study.sets import StreetObjects
from mlsroad_pipeline.papers.shared.recognition.disturbances import Disturbance, disturb
from mlsroad_pipeline.papers.shared.recognition.object_set import ObjectArrays, ObjectSet
from mlsroad_pipeline.papers.shared.recognition.recogniser import make_recogniser, probabilities


class Recognised(TypedDict):
    """Class scores of test objects under every condition."""

    scores: NDArray[np.floating]  # (conditions, objects, classes): class scores
    label: NDArray[np.integer]  # (objects,): true classes
    street: NDArray[np.int64]  # (objects,): seed of the street, or number of the object where it comes from a file
    seconds: NDArray[np.float64]  # (conditions,): CPU time of recognition


class TrainingFacts(TypedDict):
    """Facts of a trained recogniser, as arrays."""

    train_seconds: NDArray[np.floating]  # CPU time of training
    model_bytes: NDArray[np.integer]  # size of the model
    objects: NDArray[np.integer]  # number of training objects
    dimension: NDArray[np.integer]  # length of the descriptor; 0 for networks
    tried: NDArray[np.floating]  # (settings,): accuracy of each setting on validation objects; NaN without them
    chosen: NDArray[np.integer]  # index of the setting that is used


def disturb_objects(objects: ObjectSet, disturbance: Disturbance, seed: int) -> ObjectSet:
    """Disturb each object of a set."""
    if disturbance == Disturbance() or not len(objects):
        return objects
    seeds = np.random.SeedSequence(seed).generate_state(len(objects), np.uint64)
    intensities = objects.intensities
    disturbed = [
        disturb(xyz, disturbance, seed=int(own), intensity=None if intensities is None else intensities[i])
        for i, (xyz, own) in enumerate(zip(objects.objects, seeds, strict=True))
    ]
    values = None if intensities is None else [value for _, value in disturbed if value is not None]
    return ObjectSet.from_objects([xyz for xyz, _ in disturbed], objects.label, values)


def mislabel(objects: ObjectSet, share: float, seed: int) -> ObjectSet:
    """Assign a wrong class to a share of the objects."""
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
) -> dict[str, Any]:
    """Train a recogniser and recognise test objects under every disturbance: `Recognised` and `TrainingFacts`."""
    learned = ObjectSet.join([ObjectSet.from_arrays(train[key]) for key in sorted(train)])
    learned = mislabel(disturb_objects(learned, disturbance, seed + 1), wrong_labels, seed + 2)
    fitted, tried, seconds = [], [], []
    for parameters in settings:
        start = time.process_time()
        recogniser = make_recogniser(method, parameters)
        fitted.append(_fitted(recogniser, learned, tolerant=validation is not None))
        seconds.append(time.process_time() - start)
        tried.append(
            np.nan if validation is None else _accuracy(fitted[-1], ObjectSet.from_arrays(validation), n_classes)
        )
    chosen = int(np.argmax(tried)) if validation is not None else 0
    objects, recogniser = ObjectSet.from_arrays(test), fitted[chosen]
    probabilities(recogniser, objects.take(np.arange(min(len(objects), 1))), n_classes)  # compilation is not timed
    scores, times = [], []
    for level in conditions.values():
        disturbed = disturb_objects(objects, level, seed)
        start = time.process_time()
        scores.append(probabilities(recogniser, disturbed, n_classes)["scores"])
        times.append(time.process_time() - start)
    describe = getattr(recogniser, "describe_objects", None)
    facts: TrainingFacts = {
        "train_seconds": np.array(seconds[chosen]),
        "model_bytes": np.array(sum(array.nbytes for array in recogniser.to_arrays().values())),
        "objects": np.array(len(learned)),
        "dimension": np.array(0 if describe is None else describe(objects.objects[:1], recogniser.radius_).shape[1]),
        "tried": np.array(tried),
        "chosen": np.array(chosen),
    }
    results: Recognised = {
        "scores": np.stack(scores),
        "label": objects.label,
        "street": np.asarray(test.get("street", np.arange(len(objects)))),
        "seconds": np.array(times),
    }
    return {"results": results, "facts": facts}


def _fitted(recogniser: Any, objects: ObjectSet, *, tolerant: bool) -> Any:
    """Return a trained recogniser; None for a setting to try whose training diverges."""
    try:
        return recogniser.fit(objects.objects, objects.label, intensities=objects.intensities)
    except DataError as error:
        if not tolerant or "diverged" not in str(error):
            raise
        return None


def _accuracy(recogniser: Any, objects: ObjectSet, n_classes: int) -> float:
    if recogniser is None:
        return 0.0
    return float((probabilities(recogniser, objects, n_classes)["label"] == objects.label).mean())


def measure_network(*, parameters: Any, n_classes: int) -> dict[str, NDArray]:
    """Measure size, memory and time of one network."""
    from mlsroad_pipeline.papers.luo2019.study import efficiency  # noqa: PLC0415  # only the worker imports PyTorch

    return efficiency.measure_network(parameters=parameters, n_classes=n_classes)
