"""Training of the object matching: choice of prototypes and thresholds."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.papers.shared.detection.sampling import TrainingObjects, select_objects
from mlsroad_pipeline.papers.shared.detection.thresholds import best_threshold, choose_queries
from mlsroad_pipeline.papers.shared.detection.training import train_object_detector
from mlsroad_pipeline.papers.yu2016.object_matching.detector import (
    SLUG,
    ObjectMatcher,
    ObjectMatchingParameters,
    object_similarity,
)


def fit_object_matching(
    objects: TrainingObjects, parameters: ObjectMatchingParameters
) -> tuple[ObjectMatcher, dict[str, Any]]:
    """Choose prototypes and thresholds; no training object is compared with itself."""
    p = parameters
    parts, labels, n_classes, intensity, weights, n_threads = objects
    drawn, sample, truth = examples = objects.sample(p)
    geometry = np.array([p.feature_share, p.reach, p.limit, p.n_neighbors, p.n_turns, p.n_sweeps, p.least])
    rng = np.random.default_rng(p.seed)
    chosen: list[NDArray[np.int64]] = []
    thresholds, reached = [], []
    for k in range(n_classes):
        mine = examples.candidates(k, p.candidates, rng)
        similarities = object_similarity(
            sample, select_objects(sample, mine), geometry, intensity=intensity, n_threads=n_threads
        )
        queries = choose_queries(similarities.T, mine, truth == k, max_queries=p.max_prototypes)[0]
        chosen.append(mine[queries])
        # The threshold is chosen on all objects, see `TrainingObjects.sample`.
        models = select_objects(sample, np.sort(chosen[k]))
        similarities = object_similarity(parts, models, geometry, intensity=intensity, n_threads=n_threads)
        similarities[drawn[np.sort(chosen[k])], np.arange(len(queries))] = 0.0
        f_score, threshold = best_threshold(similarities.max(axis=1, initial=0.0), labels == k, weights)
        thresholds.append(threshold)
        reached.append(f_score)
    every = np.concatenate(chosen)
    order = np.argsort(every)
    kinds = np.repeat(np.arange(n_classes), [len(c) for c in chosen])[order].astype(np.int16)
    matcher = ObjectMatcher(select_objects(sample, every[order]), kinds, np.array(thresholds), geometry, intensity)
    return matcher, {"prototypes": [len(c) for c in chosen], "f_scores": reached}


train_object_matching = partial(train_object_detector, fit=fit_object_matching, slug=SLUG, uses_intensity=True)
"""Trains a model of this method, see `train_object_detector`."""
