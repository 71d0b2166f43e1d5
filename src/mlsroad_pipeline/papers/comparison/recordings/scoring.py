"""Scoring of a model on a recording: confusion matrices, calibration and times."""

import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.metrics.calibration import auroc, brier_score, reliability_table
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix
from mlsroad_pipeline.algorithms.models.bundle import bundle_scheme
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.algorithms.models.pool.labeller import with_trees
from mlsroad_pipeline.algorithms.scenes.parts import TEST
from mlsroad_pipeline.execution.task import StoredResult
from mlsroad_pipeline.papers.comparison.recordings.preparation import stored_model
from mlsroad_pipeline.papers.shared.evaluation import coarse_labels


def score_source(
    scenes: Sequence[StoredResult],
    model: Mapping[str, Any],
    pool: Mapping[str, Any] | None = None,
    *,
    scheme: ClassScheme,
    mixed: Mapping[str, Sequence[str]],
    only_test: bool,
) -> dict[str, dict[str, NDArray]]:
    """Label all scenes of a recording, and score all points and those of the test part.

    The model replaces the trees of `pool`, if that is given. A prediction of a class that a mixed class of the
    recording holds counts as that class.
    """
    bundle = stored_model(model) if pool is None else with_trees(stored_model(pool), stored_model(model))
    trained = bundle_scheme(bundle)
    truths, labels, confidences, parts = [], [], [], []
    wall = used = 0.0
    for number, handle in enumerate(scenes):
        scene = handle.load()
        unknown = scene.without_columns(["label", "part"])
        if number == 0:
            label_cloud(bundle, unknown)
        start, begin = time.perf_counter(), time.process_time()
        label, confidence = label_cloud(bundle, unknown)
        wall, used = wall + time.perf_counter() - start, used + time.process_time() - begin
        truths.append(scheme.encode(scene["label"], source=scene.source))
        labels.append(coarse_labels(label, trained, scheme))
        confidences.append(confidence)
        parts.append(scene["part"])
    truth, label, confidence, part = (np.concatenate(each) for each in (truths, labels, confidences, parts))
    predicted = unmixed(truth, label, scheme, mixed)
    chosen = {"test": part == TEST} if only_test else {"all": np.ones(len(part), np.bool_), "test": part == TEST}
    times = {"points": len(label), "seconds": wall, "cpu_seconds": used}
    middle = len(scenes) // 2
    return {
        **{name: score_points(truth[r], predicted[r], confidence[r], len(scheme)) for name, r in chosen.items()},
        "times": {name: np.array(value) for name, value in times.items()},
        "picture": {"label": labels[middle].astype(np.int8), "confidence": confidences[middle].astype(np.float16)},
        "finished": {"date": np.array(datetime.now(UTC).strftime("%Y-%m-%d %H:%M"))},
    }


def unmixed(
    truth: NDArray[np.integer], label: NDArray[np.integer], scheme: ClassScheme, mixed: Mapping[str, Sequence[str]]
) -> NDArray[np.int16]:
    """Replace predictions that a mixed class holds by that class, where it is the true one."""
    predicted = label.astype(np.int16)
    for name, held in mixed.items():
        (own,) = scheme.labels_of([name])
        predicted[(truth == own) & np.isin(label, scheme.labels_of(held))] = own
    return predicted


def score_points(
    truth: NDArray[np.integer], predicted: NDArray[np.integer], confidence: NDArray[np.floating], n_classes: int
) -> dict[str, NDArray]:
    """Return the confusion matrix and the calibration of labelled points with a known class."""
    known = truth != IGNORE
    right, score = (predicted == truth)[known], np.clip(confidence[known].astype(np.float64), 0, 1)
    table = reliability_table(score, right)
    return {
        "matrix": confusion_matrix(truth, predicted, n_classes),
        "bin_counts": table.counts,
        "bin_hits": table.hits,
        "bin_confidences": table.confidences,
        "auroc": np.array(auroc(score, right)),
        "brier_score": np.array(brier_score(score, right)),
    }
