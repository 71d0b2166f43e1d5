"""Prototypes and thresholds of the object matching chosen on training objects; see `object_matching`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines.object_matching import (
    ENTRY_POINT,
    SLUG,
    ObjectMatcher,
    ObjectMatchingParameters,
    likeness,
)
from mlsroad_pipeline.algorithms.classes import ClassScheme
from mlsroad_pipeline.algorithms.detection import DetectionParameters, best_threshold
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.algorithms.object_detector_training import (
    choose_queries,
    sample_objects,
    select_objects,
    train_object_detector,
)
from mlsroad_pipeline.algorithms.object_detectors import (
    Description,
    DetectionStages,
    object_bounds,
)


def fit_object_matching(
    parts: Description,
    labels: NDArray[np.int16],
    intensity: bool,
    *,
    parameters: ObjectMatchingParameters,
    n_classes: int,
    n_threads: int = 1,
) -> tuple[ObjectMatcher, dict[str, Any]]:
    """Choose prototypes and thresholds on training objects, of which none is compared with itself.

    Parameters
    ----------
    parts : mapping
        Parts of the training objects.
    labels : ndarray of int16, shape (n,)
        Class of each object, -1 for others.
    intensity : bool
        Whether intensities count.
    parameters : ObjectMatchingParameters
        Parameters.
    n_classes : int
        Wanted classes.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    matcher : ObjectMatcher
        The prototypes.
    facts : dict
        Number of prototypes, and the F-score of each class on the training objects.
    """
    p = parameters
    drawn = sample_objects(labels, max_per_class=p.max_per_class, max_others=p.max_others, seed=p.seed)
    sample, truth = select_objects(parts, drawn), labels[drawn]
    geometry = np.array([p.feature_share, p.reach, p.limit, p.n_neighbors, p.n_turns, p.n_sweeps, p.least])
    some = np.diff(object_bounds(sample)) > 0
    rng = np.random.default_rng(p.seed)
    chosen: list[NDArray[np.int64]] = []
    thresholds, reached = [], []
    for k in range(n_classes):
        mine = np.flatnonzero((truth == k) & some)
        if len(mine) > p.candidates:
            mine = np.sort(rng.choice(mine, p.candidates, replace=False))
        found = likeness(sample, select_objects(sample, mine), geometry, intensity=intensity, n_threads=n_threads)
        queries = choose_queries(found.T, mine, truth == k, max_queries=p.max_prototypes)[0]
        chosen.append(mine[queries])
        # The threshold is chosen on all objects, drawn or not: among the drawn ones others are rarer than in a street.
        models = select_objects(sample, np.sort(chosen[k]))
        found = likeness(parts, models, geometry, intensity=intensity, n_threads=n_threads)
        found[drawn[np.sort(chosen[k])], np.arange(len(queries))] = 0.0
        f_score, threshold = best_threshold(found.max(axis=1, initial=0.0), labels == k)
        thresholds.append(threshold)
        reached.append(f_score)
    every = np.concatenate(chosen)
    order = np.argsort(every)
    kinds = np.repeat(np.arange(n_classes), [len(c) for c in chosen])[order].astype(np.int16)
    matcher = ObjectMatcher(select_objects(sample, every[order]), kinds, np.array(thresholds), geometry, intensity)
    return matcher, {"prototypes": [len(c) for c in chosen], "f_scores": reached}


def train_object_matching(
    parts: Mapping[str, Description],
    labels: Mapping[str, Mapping[str, NDArray]],
    *,
    parameters: ObjectMatchingParameters,
    stages: DetectionStages,
    detection: DetectionParameters,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
    n_threads: int = 1,
) -> ModelBundle:
    """Train a model on the objects that the training scenes own.

    Parameters
    ----------
    parts : mapping of str to mapping
        What `describe_parts` gave for each training scene.
    labels : mapping of str to mapping
        What `object_classes` gave for each of them.
    parameters : ObjectMatchingParameters
        Parameters of the method.
    stages : DetectionStages
        How the scenes were prepared.
    detection : DetectionParameters
        The wanted classes.
    scheme : ClassScheme
        The classes.
    trained_on : mapping
        What the metadata say of the training data; JSON values.
    n_threads : int, default 1
        Threads; the model does not depend on it.

    Returns
    -------
    ModelBundle
        The model.

    Raises
    ------
    DataError
        If there are no training scenes.
    """
    n = len(detection.classes)

    def fit(joined: Description, truth: NDArray[np.int16], intensity: bool) -> tuple[ObjectMatcher, dict[str, Any]]:
        return fit_object_matching(joined, truth, intensity, parameters=parameters, n_classes=n, n_threads=n_threads)

    return train_object_detector(
        parts, labels, fit, slug=SLUG, entry_point=ENTRY_POINT, parameters=parameters,
        uses_intensity=True, stages=stages, detection=detection, scheme=scheme, trained_on=trained_on,
    )  # fmt: skip
