"""Prototypes and thresholds of the object matching chosen on training objects; see `object_matching`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines.object_matching.detector import (
    SLUG,
    ObjectMatcher,
    ObjectMatchingParameters,
    likeness,
)
from mlsroad_pipeline.algorithms.detection.descriptions import Description, object_bounds
from mlsroad_pipeline.algorithms.detection.thresholds import best_threshold
from mlsroad_pipeline.algorithms.detection.training import (
    choose_queries,
    make_trainer,
    sample_objects,
    select_objects,
)


def fit_object_matching(
    parts: Description,
    labels: NDArray[np.int16],
    intensity: bool,
    *,
    parameters: ObjectMatchingParameters,
    n_classes: int,
    weights: NDArray[np.float64] | None = None,
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
    weights : ndarray of float64, shape (n,), optional
        How often each object counts when thresholds are chosen, see `training_weights`; once by default.
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
        f_score, threshold = best_threshold(found.max(axis=1, initial=0.0), labels == k, weights)
        thresholds.append(threshold)
        reached.append(f_score)
    every = np.concatenate(chosen)
    order = np.argsort(every)
    kinds = np.repeat(np.arange(n_classes), [len(c) for c in chosen])[order].astype(np.int16)
    matcher = ObjectMatcher(select_objects(sample, every[order]), kinds, np.array(thresholds), geometry, intensity)
    return matcher, {"prototypes": [len(c) for c in chosen], "f_scores": reached}


train_object_matching = make_trainer(fit_object_matching, slug=SLUG, uses_intensity=True)
"""Trains a model; see `object_detector_training.Trainer`."""
