"""Methods that recognise objects, by their slugs: training sets, models, and labelling from raw coordinates on.

A method is imported when it is used, for some of them import PyTorch.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.detection.detector import (
    DetectionStages,
    ObjectLabels,
    Segments,
    label_detected_objects,
)
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS, Method, methods_of
from mlsroad_pipeline.algorithms.recognition.cutting import (
    RecognitionParameters,
    objects_of_segments,
    training_objects,
)
from mlsroad_pipeline.algorithms.recognition.object_set import ObjectSet

logger = logging.getLogger(__name__)


def _recogniser_of(slug: str) -> Method:
    method = METHODS.get(slug)
    if method is None or method.task != "recognition":
        raise ParameterError(f"{slug!r} is no recogniser (recognisers: {', '.join(methods_of('recognition'))})")
    return method


def make_recogniser(slug: str, parameters: Any) -> Any:
    """Make a recogniser that is not trained yet.

    Parameters
    ----------
    slug : str
        One of the recognisers of `METHODS`.
    parameters : dataclass
        Its parameters; a sub-network takes those of JointNet.

    Returns
    -------
    Recogniser
        The recogniser.

    Raises
    ------
    ParameterError
        If there is no such method.
    """
    method = _recogniser_of(slug)
    return method.load("use")(parameters.with_views(method.variant) if method.variant else parameters)


def train_recogniser(
    sets: Sequence[Mapping[str, NDArray]],
    *,
    slug: str,
    parameters: Any,
    recognition: RecognitionParameters,
    stages: DetectionStages,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
) -> ModelBundle:
    """Train a method and pack what it learned.

    Parameters
    ----------
    sets : sequence of mapping
        Arrays of `ObjectSet`: the training objects.
    slug : str
        The method.
    parameters : dataclass
        Its parameters.
    recognition : RecognitionParameters
        Which objects are recognised.
    stages : DetectionStages
        How the scenes were prepared.
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
        If there are no objects of two classes to learn from.
    """
    chosen = training_objects(sets, recognition)
    found = make_recogniser(slug, parameters).fit(chosen.objects, chosen.label, intensities=chosen.intensities)
    given = [int(label) for label in found.classes_]
    metadata = {
        "classes": list(scheme.classes),
        "classes_given": [scheme.classes[label] for label in given],
        "wanted": list(range(len(scheme))),
        "scheme": asdict(scheme),
        "parameters": {**asdict(stages), "recogniser": found.describe(), "recognition": asdict(recognition)},
        "attributes": ["intensity"] if chosen.intensity is not None and METHODS[slug].uses_intensity else [],
        "learned": {"objects": np.bincount(chosen.label, minlength=len(scheme)).tolist()},
        "trained_on": dict(trained_on),
    }
    return ModelBundle(slug, found.to_arrays(), metadata)


def load_recogniser(bundle: ModelBundle) -> Any:
    """Rebuild the recogniser of a model.

    Parameters
    ----------
    bundle : ModelBundle
        A model of `train_recogniser`.

    Returns
    -------
    Recogniser
        The recogniser.

    Raises
    ------
    ParameterError
        If there is no such method.
    DataError
        If the model's arrays do not fit it, or its classes are not those of the model's scheme.
    """
    method = _recogniser_of(bundle.slug)
    kind, parameters = method.load("use"), method.load("parameters")
    found = kind.from_arrays(bundle.arrays, parameters(**bundle.metadata["parameters"]["recogniser"]))
    labels = np.asarray(found.classes_)
    if labels.dtype.kind not in "iu" or labels.min() < 0 or labels.max() >= len(bundle.classes):
        raise DataError(f"model {bundle.slug!r} knows the labels {labels.tolist()}, of {len(bundle.classes)} classes")
    named, given = [bundle.classes[label] for label in labels], bundle.metadata["classes_given"]
    if named != list(given):
        raise DataError(
            f"model {bundle.slug!r} was trained on {', '.join(given)}; its arrays are of {', '.join(named)}"
        )
    return found


def probabilities(recogniser: Any, objects: ObjectSet, n_classes: int) -> dict[str, NDArray]:
    """Recognise objects.

    Parameters
    ----------
    recogniser : Recogniser
        A trained method whose classes are labels.
    objects : ObjectSet
        The objects.
    n_classes : int
        Classes of the scheme.

    Returns
    -------
    dict of str to ndarray
        ``label`` int16 (objects,), ``score`` float32: its probability; ``scores`` float32 (objects, n_classes), 0 for
        classes that were not learned.
    """
    scores = np.zeros((len(objects), n_classes), dtype=np.float32)
    if len(objects):
        scores[:, recogniser.classes_] = recogniser.predict_proba(objects.objects, intensities=objects.intensities)
    label = scores.argmax(axis=1).astype(np.int16)
    return {"label": label, "score": scores.max(axis=1, initial=0.0), "scores": scores}


def recognise_objects(objects: Mapping[str, NDArray], bundle: ModelBundle) -> dict[str, NDArray]:
    """Recognise a set of objects with a model.

    Parameters
    ----------
    objects : mapping
        Arrays of an `ObjectSet`.
    bundle : ModelBundle
        The model.

    Returns
    -------
    dict of str to ndarray
        What `probabilities` gives.
    """
    return probabilities(load_recogniser(bundle), ObjectSet.from_arrays(objects), len(bundle.classes))


def train_and_recognise(
    train: Mapping[str, Mapping[str, NDArray]],
    test: Mapping[str, NDArray],
    *,
    slug: str,
    parameters: Any,
    recognition: RecognitionParameters,
    n_classes: int,
) -> dict[str, NDArray]:
    """Learn from some folds and recognise another.

    Parameters
    ----------
    train : mapping of str to mapping
        Folds to learn from.
    test : mapping
        The fold to recognise.
    slug : str
        The method.
    parameters : dataclass
        Its parameters.
    recognition : RecognitionParameters
        Which objects are recognised.
    n_classes : int
        Classes of the scheme.

    Returns
    -------
    dict of str to ndarray
        What `probabilities` gives.
    """
    chosen = training_objects([train[key] for key in sorted(train)], recognition)
    found = make_recogniser(slug, parameters).fit(chosen.objects, chosen.label, intensities=chosen.intensities)
    return probabilities(found, ObjectSet.from_arrays(test), n_classes)


def label_cloud(cloud: PointCloud, bundle: ModelBundle) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Give the points of recognised objects their class and probability, from raw coordinates on; all others none.

    Parameters
    ----------
    cloud : PointCloud
        Points. Where it has the columns `ground` and `height`, as `find_ground` gives them, they are taken.
    bundle : ModelBundle
        A model of `train_recogniser`.

    Returns
    -------
    labels : ndarray of int16, shape (n,)
        Labels of the model's scheme, -1 outside objects.
    confidence : ndarray of float32, shape (n,)
        Probability of the class; 0 outside.

    Raises
    ------
    DataError
        If a coordinate is NaN or infinite, or the model's parts do not fit each other.
    """
    recogniser = load_recogniser(bundle)
    least = RecognitionParameters(**bundle.metadata["parameters"]["recognition"]).min_points

    def detect(objects: Segments) -> ObjectLabels:
        every = objects_of_segments(cloud, objects["objects"])
        large = np.flatnonzero(np.diff(every.indptr) >= least)
        found = probabilities(recogniser, every.take(large), len(bundle.classes))
        label, score = every.label, np.zeros(len(every), dtype=np.float32)
        label[large], score[large] = found["label"], found["score"]
        return {"label": label, "score": score}

    return label_detected_objects(cloud, bundle, detect)
