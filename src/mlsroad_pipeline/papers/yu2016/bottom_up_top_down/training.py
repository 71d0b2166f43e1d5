"""Training of bottom-up and top-down matching: choice of spin images, models and thresholds."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.papers.shared.detection.sampling import TrainingObjects, sample_objects, select_objects
from mlsroad_pipeline.papers.shared.detection.thresholds import best_threshold, choose_queries
from mlsroad_pipeline.papers.shared.detection.training import train_object_detector
from mlsroad_pipeline.papers.yu2016.bottom_up_top_down.detector import (
    SLUG,
    BottomUpTopDown,
    BottomUpTopDownParameters,
    class_shares,
    overlaps,
)


def fit_bottom_up_top_down(
    objects: TrainingObjects, parameters: BottomUpTopDownParameters
) -> tuple[BottomUpTopDown, dict[str, Any]]:
    """Choose database, models and thresholds; no training object is compared with itself."""
    p = parameters
    parts, labels, n_classes, _, weights, n_threads = objects
    drawn, sample, truth = examples = objects.sample(p)
    rows = sample_objects(
        truth[sample["objects"]], max_per_class=p.max_images, max_others=3 * p.max_images, seed=p.seed
    )
    owner = np.ascontiguousarray(sample["objects"][rows])
    images, image_kinds = np.ascontiguousarray(sample["images"][rows]), truth[owner].astype(np.int16)
    # Thresholds are chosen on all objects, see `TrainingObjects.sample`.
    known = drawn[owner].astype(np.int32)
    every_share = class_shares(parts, images, image_kinds, known, n_classes=n_classes, n_threads=n_threads)
    shares = every_share[drawn]
    geometry = np.array([p.reach, p.n_steps, p.n_azimuths, p.n_bands], dtype=np.float64)
    rng = np.random.default_rng(p.seed)
    models: list[NDArray[np.int64]] = []
    chosen: list[tuple[float, float, float, float]] = []
    for k in range(n_classes):
        mine = examples.candidates(k, p.candidates, rng)
        every = np.ones((len(truth), len(mine)), dtype=np.bool_)
        overlap = overlaps(sample, select_objects(sample, mine), geometry, wanted=every, n_threads=n_threads)
        queries, gate = _choose_models(overlap, shares[:, k], mine, truth == k, p)
        models.append(np.sort(mine[queries]))
        wanted = (every_share[:, k] >= gate[0]) & (every_share[:, k] > 0)
        pairs = np.repeat(wanted[:, None], len(queries), axis=1)
        overlap = overlaps(parts, select_objects(sample, models[k]), geometry, wanted=pairs, n_threads=n_threads)
        overlap[drawn[models[k]], np.arange(len(queries))] = 0.0
        scores = overlap.max(axis=1, initial=0.0) * np.where(wanted, every_share[:, k] ** gate[1], 0.0)
        chosen.append((*best_threshold(scores, labels == k, weights), *gate))
    every_model = np.concatenate(models)
    order = np.argsort(every_model)
    kinds = np.repeat(np.arange(n_classes), [len(rows) for rows in models])[order].astype(np.int16)
    described = select_objects({name: sample[name] for name in sample if name != "images"}, every_model[order])
    reached, thresholds, least, exponents = (np.array(values) for values in zip(*chosen, strict=True))
    detector = BottomUpTopDown(images, image_kinds, described, kinds, least, exponents, thresholds, geometry)
    return detector, {
        "images": len(images), "models": [len(rows) for rows in models], "least_shares": least.tolist(),
        "exponents": exponents.tolist(), "f_scores": reached.tolist(),
    }  # fmt: skip


def _choose_models(
    overlap: NDArray, share: NDArray, mine: NDArray[np.int64], truth: NDArray[np.bool_], p: BottomUpTopDownParameters
) -> tuple[list[int], tuple[float, float]]:
    """Return the models, the least share and the exponent of a class that give the best F-score."""
    best: tuple[list[int], tuple[float, float]] = ([], (0.0, 0.0))
    reached = -1.0
    for exponent in p.exponents:
        for least in p.least_shares:
            gate = np.where((share >= least) & (share > 0), share**exponent, 0.0)
            similarities = (overlap * gate[:, None]).T
            queries, _, f_score = choose_queries(similarities, mine, truth, max_queries=p.max_models)
            if f_score > reached:
                reached, best = f_score, (queries, (least, exponent))
    return best


train_bottom_up_top_down = partial(train_object_detector, fit=fit_bottom_up_top_down, slug=SLUG, uses_intensity=False)
"""Trains a model of this method, see `train_object_detector`."""
