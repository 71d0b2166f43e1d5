"""Database, models and thresholds chosen on training objects; see `bottom_up_top_down`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines.bottom_up_top_down.detector import (
    SLUG,
    BottomUpTopDown,
    BottomUpTopDownParameters,
    class_shares,
    overlaps,
)
from mlsroad_pipeline.algorithms.detection.descriptions import Description, object_bounds
from mlsroad_pipeline.algorithms.detection.thresholds import best_threshold
from mlsroad_pipeline.algorithms.detection.training import (
    choose_queries,
    make_trainer,
    sample_objects,
    select_objects,
)


def fit_bottom_up_top_down(
    parts: Description,
    labels: NDArray[np.int16],
    _intensity: bool = False,
    *,
    parameters: BottomUpTopDownParameters,
    n_classes: int,
    weights: NDArray[np.float64] | None = None,
    n_threads: int = 1,
) -> tuple[BottomUpTopDown, dict[str, Any]]:
    """Choose database, models and thresholds on training objects, of which none is compared with itself.

    Parameters
    ----------
    parts : mapping
        Surfaces of the training objects.
    labels : ndarray of int16, shape (n,)
        Class of each object, -1 for others.
    _intensity : bool, default False
        Not used: the descriptors know of shape alone.
    parameters : BottomUpTopDownParameters
        Parameters.
    n_classes : int
        Wanted classes.
    weights : ndarray of float64, shape (n,), optional
        How often each object counts when thresholds are chosen, see `training_weights`; once by default.
    n_threads : int, default 1
        Threads; the result does not depend on it.

    Returns
    -------
    detector : BottomUpTopDown
        The detector.
    facts : dict
        Images, models, what was chosen, and the F-score of each class on the training objects.
    """
    p = parameters
    drawn = sample_objects(labels, max_per_class=p.max_per_class, max_others=p.max_others, seed=p.seed)
    sample, truth = select_objects(parts, drawn), labels[drawn]
    rows = sample_objects(
        truth[sample["objects"]], max_per_class=p.max_images, max_others=3 * p.max_images, seed=p.seed
    )
    owner = np.ascontiguousarray(sample["objects"][rows])
    images, image_kinds = np.ascontiguousarray(sample["images"][rows]), truth[owner].astype(np.int16)
    # Thresholds are chosen on all objects, drawn or not: among the drawn ones others are rarer than in a street.
    known = drawn[owner].astype(np.int32)
    every_share = class_shares(parts, images, image_kinds, known, n_classes=n_classes, n_threads=n_threads)
    shares = every_share[drawn]
    geometry = np.array([p.reach, p.n_steps, p.n_azimuths, p.n_bands], dtype=np.float64)
    rng = np.random.default_rng(p.seed)
    models: list[NDArray[np.int64]] = []
    chosen: list[tuple[float, float, float, float]] = []
    for k in range(n_classes):
        mine = np.flatnonzero((truth == k) & (np.diff(object_bounds(sample)) > 0))
        if len(mine) > p.candidates:
            mine = np.sort(rng.choice(mine, p.candidates, replace=False))
        every = np.ones((len(truth), len(mine)), dtype=np.bool_)
        found = overlaps(sample, select_objects(sample, mine), geometry, wanted=every, n_threads=n_threads)
        queries, gate = _choose_models(found, shares[:, k], mine, truth == k, p)
        models.append(np.sort(mine[queries]))
        wanted = (every_share[:, k] >= gate[0]) & (every_share[:, k] > 0)
        asked = np.repeat(wanted[:, None], len(queries), axis=1)
        found = overlaps(parts, select_objects(sample, models[k]), geometry, wanted=asked, n_threads=n_threads)
        found[drawn[models[k]], np.arange(len(queries))] = 0.0
        scores = found.max(axis=1, initial=0.0) * np.where(wanted, every_share[:, k] ** gate[1], 0.0)
        chosen.append((*best_threshold(scores, labels == k, weights), *gate))
    every_model = np.concatenate(models)
    order = np.argsort(every_model)
    kinds = np.repeat(np.arange(n_classes), [len(found) for found in models])[order].astype(np.int16)
    described = select_objects({name: sample[name] for name in sample if name != "images"}, every_model[order])
    reached, thresholds, least, exponents = (np.array(values) for values in zip(*chosen, strict=True))
    detector = BottomUpTopDown(images, image_kinds, described, kinds, least, exponents, thresholds, geometry)
    return detector, {
        "images": len(images), "models": [len(found) for found in models], "least_shares": least.tolist(),
        "exponents": exponents.tolist(), "f_scores": reached.tolist(),
    }  # fmt: skip


def _choose_models(
    found: NDArray, share: NDArray, mine: NDArray[np.int64], truth: NDArray[np.bool_], p: BottomUpTopDownParameters
) -> tuple[list[int], tuple[float, float]]:
    """Return the models of a class, and the least share and the exponent that are best with them."""
    best: tuple[list[int], tuple[float, float]] = ([], (0.0, 0.0))
    reached = -1.0
    for exponent in p.exponents:
        for least in p.least_shares:
            gate = np.where((share >= least) & (share > 0), share**exponent, 0.0)
            alike = (found * gate[:, None]).T
            queries, _, f_score = choose_queries(alike, mine, truth, max_queries=p.max_models)
            if f_score > reached:
                reached, best = f_score, (queries, (least, exponent))
    return best


train_bottom_up_top_down = make_trainer(fit_bottom_up_top_down, slug=SLUG, uses_intensity=False)
"""Trains a model; see `object_detector_training.Trainer`."""
